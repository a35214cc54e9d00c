"""The best checkpoint of a training: chosen on validation episodes, kept, and measured once on test episodes."""

import json
import logging
import shutil
from contextlib import closing
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from lidarnaut.agents import callbacks, evaluation, learning
from lidarnaut.agents.curves import curve_of, interval_of, read_evaluations, result_of
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.learned import find_policy
from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.agents.run_folder import BEST, CheckpointError, find_checkpoint, is_measured, list_checkpoints
from lidarnaut.agents.training import train
from lidarnaut.envs.progress import Progress
from tests.agents.test_training import changed

SCORES = (5.0, 1.0, 9.0, 9.0, 2.0, 3.0)
"""Headline measure of the evaluations at steps 0, 128, ...: the best is at step 384, the later of two."""


class Killed(BaseException):
    """Ends a training without saving, like a signal."""


@pytest.fixture
def config(tiny_data):
    often = {"every": 128, "at_start": True, "episodes": 2, "references": []}
    return changed(tiny_data, total_steps=640, evaluation=often, checkpoints={"every": 128, "keep": 2})


@pytest.fixture
def scored(monkeypatch):
    """Replace the headline measure of evaluations by step; -1 stands for the test episodes."""
    whole = callbacks.Evaluator.policy

    def policy(self, policy, split="validation", *, progress=False):
        row = whole(self, policy, split)
        if split == "validation":
            step = 128 * scored.count
            row |= {"area": SCORES[step // 128]}
            scored.count += 1
        return row

    scored.count = 0
    monkeypatch.setattr(callbacks.Evaluator, "policy", policy)
    return scored


def steps_of(run):
    return [int(path.name[5:]) for path in list_checkpoints(run)]


def best_of(run):
    return int(find_checkpoint(run, "best").name[5:])


def test_the_best_is_kept_named_and_measured_once(config, scored, tmp_path, caplog, monkeypatch):
    caplog.set_level(logging.INFO, "lidarnaut.agents")
    episodes, whole = [], evaluation.run_episodes

    def noted(vector, act, speed, seed, bar):
        episodes.append((vector.get_attr("world")[0], range(seed, seed + vector.num_envs)))
        return whole(vector, act, speed, seed, bar)

    monkeypatch.setattr(evaluation, "run_episodes", noted)
    run = train(config, run=tmp_path / "run", progress=False)
    *validation, (_, test) = episodes
    assert (len(validation), len(set(validation)), test) == (6, 1, range(2))
    assert not {*test} & {*validation[0][1]}
    assert steps_of(run) == [384, 512, 640]
    rows = read_evaluations(run)
    assert [row["steps"] for row in curve_of(rows)] == [0, 128, 256, 384, 512, 640]
    assert {row["split"] for row in curve_of(rows)} == {"validation"}
    assert (result_of(rows)["steps"], result_of(rows)["split"]) == (384, "test")
    assert any("learned in 2 test episodes: area m² " in message for message in caplog.messages)
    for name, step in (("", 384), ("@best", 384), ("@last", 640), ("@512", 512)):
        folder = run / "checkpoints" / f"step_{step:09d}"
        assert find_policy(f"ppo:{run}{name}") == folder
        assert LearnedPolicy.load(f"{run}{name}", trust="tests")._name == str(folder)
        assert parse_policy(f"ppo:{run}{name}", trust=["tests"]).checkpoint == str(folder)
    assert parse_policy(f"ppo:{tmp_path}/r*@last", trust=["tests"]).checkpoint.endswith("640")
    assert find_checkpoint(run).name == "step_000000640"
    assert f"{run}: checkpoint of step 384, the best in the validation episodes" in caplog.messages
    with pytest.raises(CheckpointError, match=r"no checkpoint 'bets' \(did you mean 'best'\?\); allowed are best, la"):
        find_checkpoint(f"{run}@bets")
    monkeypatch.setattr(callbacks.RunCallback, "finish", Mock(side_effect=AssertionError))
    train(config, resume=run, progress=False)


@pytest.mark.parametrize(
    ("where", "best"),
    [("save_checkpoint", 0), ("write_file", 0), ("_write", 384)],
    ids=["before the checkpoint", "before its mark", "before the test"],
)
def test_a_kill_between_any_writes_leaves_a_best_checkpoint(where, best, config, scored, tmp_path, monkeypatch):
    """Killed at the new best of step 256 (before the checkpoint, before its mark), or after the last checkpoint."""
    run, whole = tmp_path / "run", getattr(callbacks.RunCallback if where == "_write" else callbacks, where)

    def killed(*arguments, **named):
        is_end = where == "_write" and any(row.get("split") == "test" for row in arguments[1])
        is_new = where != "_write" and scored.count == 3
        if is_end or is_new:
            raise Killed
        return whole(*arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(callbacks.RunCallback if where == "_write" else callbacks, where, killed)
        with pytest.raises(Killed):
            train(config, run=run, progress=False)
    assert best_of(run) == best
    assert not is_measured(run)
    scored.count = {0: len(curve_of(read_evaluations(run))), 384: 6}[best]
    if where == "save_checkpoint":
        scored.count -= 1  # this evaluation is repeated
    train(config, resume=run, progress=False)
    assert (best_of(run), steps_of(run)) == (384, [384, 512, 640])
    assert is_measured(run)


def test_a_resumed_run_keeps_its_best_and_an_older_start_takes_the_best_of_what_remains(config, scored, tmp_path):
    run = train(config, run=tmp_path / "run", progress=False)
    copied = shutil.copytree(run, tmp_path / "copied")
    scored.count = 4  # a worse value
    more = config.model_copy(update={"total_steps": 768})
    train(more, resume=run, progress=False)
    assert (best_of(run), steps_of(run)) == (384, [384, 640, 768])
    assert result_of(read_evaluations(run))["steps"] == 384
    # The best is newer than the checkpoint that the run goes on from.
    (copied / "checkpoints" / "step_000000512").rename(copied / "checkpoints" / "step_000000256")
    (copied / "checkpoints" / BEST).write_text(json.dumps({"step": 640}))
    scored.count = 2
    train(more, resume=copied / "checkpoints" / "step_000000384", progress=False)
    assert best_of(copied) in steps_of(copied)
    assert (copied / "checkpoints" / "step_000000640.discarded").is_dir()


def test_runs_of_earlier_versions_fall_back_to_the_last(tiny_run, tmp_path, caplog):
    caplog.set_level(logging.INFO, "lidarnaut.agents")
    run = shutil.copytree(tiny_run, tmp_path / "run")
    (run / "checkpoints" / BEST).write_text("damaged")
    assert find_checkpoint(run, "best") == list_checkpoints(run)[-1]
    (run / "checkpoints" / BEST).unlink()
    assert find_policy(run) == list_checkpoints(run)[-1]
    assert "the last, since none is marked as the best" in caplog.messages[-1]


def test_intervals_of_evaluations_have_a_width():
    none = {"policy": "learned", "success": 0.0, "scores": " ".join(["0"] * 20)}
    for measure in ("success", "sct"):
        assert interval_of(none, measure) == pytest.approx((0.0, 0.161), abs=1e-3)
    half = none | {"success": 0.5, "scores": " ".join(["0", "1"] * 10)}
    assert interval_of(half, "success") == pytest.approx((0.299, 0.701), abs=1e-3)
    low, high = interval_of(half, "sct")
    assert 0.2 < low < 0.35 < 0.65 < high < 0.8


def test_an_episode_whose_headline_is_not_finite_is_refused(tiny_config):
    with closing(evaluation.Evaluator(tiny_config)) as evaluator:
        vector = evaluation.make_vector(tiny_config.environment, "test", 1)
        (history,) = evaluation.run_episodes(vector, lambda seen, starts: np.zeros((1, 2), dtype=np.float32))
        assert evaluator.measure(history)["area"] > 0.0
        history.samples["explored_area"][-1] = np.nan
        with pytest.raises(ValueError, match="an episode has no finite area: nan"):
            evaluator.measure(history)


def test_the_bar_estimates_its_rate_from_training_alone(config, tmp_path, monkeypatch):
    """By a clock of its own: a step takes 0.01 s, and an evaluation 1,000 s, which has no part in the rate."""
    bars, seen, now = [], [], [0.0]

    def lasting(method, seconds):
        def timed(*args, **options):
            now[0] += seconds
            return method(*args, **options)

        return timed

    callback, start = callbacks.RunCallback, callbacks.RunCallback._on_rollout_start
    monkeypatch.setattr(learning, "Progress", lambda **how: bars.append(Progress(**how)) or bars[-1])
    monkeypatch.setattr(callbacks, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(callbacks.Evaluator, "policy", lasting(callbacks.Evaluator.policy, 1000.0))
    monkeypatch.setattr(callback, "_on_step", lasting(callback._on_step, 0.01))
    monkeypatch.setattr(callback, "_on_rollout_start", lambda self: start(self) or seen.append(bars[0].rate))
    train(config, run=tmp_path / "run", progress=False)
    assert seen == [0.0, *[pytest.approx(config.num_envs / 0.01)] * (len(seen) - 1)]
    assert len(seen) > 3
    assert "?" in Progress.format_meter(**{**bars[0].format_dict, "rate": 0.0})
