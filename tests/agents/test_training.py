import contextlib
import copy
import logging
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from lidarnaut.agents import callbacks
from lidarnaut.agents import evaluation as evaluation_module
from lidarnaut.agents.callbacks import RunCallback
from lidarnaut.agents.checkpoint import load_checkpoint, save_checkpoint
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import curve_of, read_evaluations
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.run_folder import find_checkpoint, list_checkpoints, new_run, write_evaluations
from lidarnaut.agents.state import is_finite
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_vec_env
from lidarnaut.envs.command_line import _interrupt
from lidarnaut.envs.files import Lock, LockedError, dump_record, parse_record, read_json, read_record
from lidarnaut.envs.processes import interrupts_delayed
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.train_command import main
from tests.agents.fake_env import ID
from tests.agents.tiny import untrained

ROOT = Path(__file__).parents[2]


def newest(run):
    return load_checkpoint(find_checkpoint(run), trust="tests")


def changed(data, **changes):
    return parse_record({**copy.deepcopy(data), **changes}, "tiny", TrainingConfig)


def evaluated_steps(run):
    return [row["steps"] for row in curve_of(read_evaluations(run))]


def test_a_run_folder_holds_what_is_promised(tiny_run, tiny_config):
    assert {path.name for path in tiny_run.iterdir()} - {".lock"} == {
        "checkpoints", "config.yaml", "evaluations.csv", "learning_curve.png", "reward.json", "tensorboard",
        "versions.json",
    }  # fmt: skip
    saved = read_record(tiny_run / "config.yaml", TrainingConfig)
    assert saved.hyperparameters == {"learning_rate": "lin_0.0007", **tiny_config.hyperparameters}
    given = {"hyperparameters": tiny_config.hyperparameters, "network": {}, "processes": None}
    assert saved.processes == 1
    assert saved.model_copy(update=given) == tiny_config
    best = find_checkpoint(tiny_run, "best")
    newest = {"step_000000512", "step_000000768"}
    assert {path.name for path in list_checkpoints(tiny_run)} == newest | {best.name}
    assert evaluated_steps(tiny_run) == [0, 256, 512, 768]
    events = EventAccumulator(str(tiny_run / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("train/value_loss")][:2] == [128, 128 * 2]
    tags = {"rollout/ep_rew_mean", "rollout/explored_fraction", "evaluation/area", "evaluation/progress"}
    assert tags <= set(events.Tags()["scalars"])
    with pytest.raises(ValueError, match=f"{tiny_run} already holds a run; resume it with --resume"):
        train(tiny_config, run=tiny_run, progress=False)


@pytest.mark.parametrize(
    ("prior", "at_start", "first"), [(0.0, None, 128), (1.0, None, 0), (0.0, True, 0), (1.0, False, 128)]
)
def test_the_untrained_policy_is_evaluated_with_a_prior_or_if_asked_for(prior, at_start, first, tiny_data, tmp_path):
    """A killed run without evaluations is resumed, and has the best checkpoint of those that it evaluated."""
    environment = {"id": "lidarnaut/ExploreFrontiersAbstract-v0", "world": "rooms", "world_size": [6, 6]}
    changes = {"network": {"width": 8, "heads": 2, "prior": prior}, "environment": environment | {"num_workers": 0}}
    changes |= {"evaluation": {"every": 128, "episodes": 1, "references": [], "at_start": at_start}}
    changes |= {"hyperparameters": {"n_steps": 8, "batch_size": 32, "n_epochs": 1}, "checkpoints": {"every": 32}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RunCallback, "_on_training_end", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt, match="at step 32 "):
            train(changed(tiny_data, **changes, total_steps=64), run=tmp_path / "run", progress=False)
    assert (tmp_path / "run" / "evaluations.csv").exists() == (first == 0)
    run = train(changed(tiny_data, **changes, total_steps=160), resume=tmp_path / "run", progress=False)
    assert evaluated_steps(run) == sorted({first, 128, 160})
    assert int(find_checkpoint(run, "best").name[5:]) in evaluated_steps(run)
    steps = [event.step for event in read_scalars(run, "train/loss")]
    assert steps == sorted(set(steps))


def test_ctrl_c_while_a_checkpoint_is_written_waits_for_its_end(tiny_data, tmp_path, monkeypatch):
    def interrupted(checkpoint, *args):
        folder = save_checkpoint(checkpoint, *args)
        if checkpoint.record.steps:
            signal.raise_signal(signal.SIGINT)
        return folder

    monkeypatch.setattr(callbacks, "save_checkpoint", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"at step \d{3} \(saved\)"):
        train(changed(tiny_data, total_steps=512), run=tmp_path / "run", progress=False)


def test_sigterm_waits_for_the_end_of_a_step_where_ctrl_c_is_ignored():
    """As in background jobs of a script; SIGTERM then ends a command by KeyboardInterrupt."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN), signal.signal(signal.SIGTERM, _interrupt)
    reached = []

    def step():
        with interrupts_delayed():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            reached.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            step()
    finally:
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])
    assert reached


def test_without_a_terminal_each_update_has_a_line_and_validations_have_a_bar(tiny_data, tmp_path, capsys):
    train(changed(tiny_data, total_steps=640), run=tmp_path / "run")
    said = capsys.readouterr().err.splitlines()
    lines = [line for line in said if "/640 [" in line and "step/s" in line]
    values = r", episode return \S+, training explored fraction \d+ %, validation area \d+\.\d m²\]"
    for step in range(128, 641, 128):
        (line,) = [line for line in lines if f" {step}/640 [" in line][:1]
        assert bool(re.search(values, line)) == (step > 128), line
        assert "?step/s" not in line
    assert any(line.startswith("validation:   0%|") and "/3 [" in line for line in said)
    ends = [line for line in said if line.startswith("validation: 100%|")]
    assert ends
    assert not any("simulated" in line for line in ends)


def test_effective_weights_of_the_reward_are_said_and_saved(tiny_data, tmp_path, caplog):
    caplog.set_level(logging.INFO, "lidarnaut.agents")
    reward = {"class": "tests.agents.test_recipes:Polite", "time": -3}
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "time_limit": 1.0, "num_workers": 0}
    config = changed(tiny_data, environment=environment | {"reward": reward}, total_steps=128)
    run = train(config, run=tmp_path / "run", progress=False)
    saved = read_json(run / "reward.json")
    assert saved["class"] == "tests.agents.test_recipes:Polite"
    assert saved["weights"] == ReachGoal.weights | {"time": -3.0, "collision": -9.0}
    assert any(
        line.startswith("reward tests.agents.test_recipes:Polite: progress 1, time -3, ") for line in caplog.messages
    )


def test_finished_episodes_of_references_are_not_repeated(tiny_data, tmp_path, monkeypatch):
    """Interrupted in the third episode of four; repeated only if the environment of evaluations changes."""
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "time_limit": 1.0, "num_workers": 0}
    evaluation = {"every": 1000, "episodes": 2, "references": ["random", "pursuit"]}
    config, begun = changed(tiny_data, environment=environment, evaluation=evaluation, total_steps=128), []

    def run_episode(env, policy, seed):
        begun.append(seed)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return whole(env, policy, seed)

    whole = evaluation_module.run_episode
    monkeypatch.setattr(evaluation_module, "run_episode", run_episode)
    with pytest.raises(KeyboardInterrupt, match="at step 128 "):
        train(config, run=tmp_path / "run", progress=False)
    assert begun == [0, 1, 0]
    run = train(config, resume=tmp_path / "run", progress=False)
    assert begun == [0, 1, 0, 0, 1]
    rows = read_evaluations(run)
    train(config.model_copy(update={"total_steps": 256}), resume=run, progress=False)
    assert len(begun) == 5
    assert read_evaluations(run)[:2] == rows[:2]
    assert rows == read_evaluations(train(config, run=tmp_path / "whole", progress=False))
    longer = changed(tiny_data, environment=environment | {"time_limit": 2.0}, evaluation=evaluation, total_steps=384)
    train(longer, resume=run, progress=False)
    assert len(begun) == 5 + 4 + 4
    sound = (run / "references.json").read_text()
    for damaged, says in (
        ("", "not readable as JSON"),
        ("[]", "must be a mapping of keys to values, got list"),
        ('{"pursuit": 1}', "pursuit: Input should be a valid list"),
        ('{"pursuit": [[]]}', "pursuit.0: Input should be a valid dictionary"),
        ('{"pursuit": [{"progress": "x"}]}', "pursuit.0.progress: Input should be a valid number"),
        ('{"pursuit": [{"progress": 1}]}', "an episode of pursuit has no .*: None"),
        (re.sub(r'"success": [\d.]+', '"success": NaN', sound, count=1), "has no finite success: nan"),
    ):
        (run / "references.json").write_text(damaged)
        with pytest.raises(ValueError, match=rf"references.json: .*{says}.*allowed are lists of episodes") as error:
            train(longer.model_copy(update={"total_steps": 512}), resume=run, progress=False)
        assert "\n" not in str(error.value)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_second_process_at_a_run_says_who_the_first_one_is(tiny_run, tiny_config, tmp_path, capsys):
    run = shutil.copytree(tiny_run, tmp_path / "run")

    def changes():
        return {path: path.stat().st_mtime_ns for path in run.rglob("*") if path.name != ".lock"}

    before = changes()
    with Lock(run):
        for resume in (run, list_checkpoints(run)[0]):
            assert main(["--resume", str(resume), "--trust", ID]) == 2
            assert f"{run} is in use: process {os.getpid()} on " in capsys.readouterr().err
        with pytest.raises(LockedError, match=f"{run} is in use"):
            train(tiny_config, run=run, progress=False)
    assert changes() == before


def test_two_trainings_of_one_second_have_folders_of_their_own(tiny_config, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda form: "20260101-000000")
    with new_run(tiny_config, None) as first, new_run(tiny_config, None) as second:
        assert second.name == f"{first.name}-2"


def test_rows_lack_measures_that_were_infinite(tmp_path):
    row = {"policy": "learned", "steps": 0, "progress": 0.5, "success": 0.5, "scores": "0.5 1.5"}
    row |= {"area": 1.0, "area_q25": 0.4, "area_q75": 0.6}
    write_evaluations(tmp_path, [row, {**row, "steps": 5, "time_to_90": 9.0}], "tiny")
    assert [str(line["time_to_90"]) for line in read_evaluations(tmp_path)] == ["nan", "9.0"]


def read_scalars(run, name):
    return EventAccumulator(str(run / "tensorboard")).Reload().Scalars(name)


def assert_logged(run, steps):
    for name in ("area", "success"):
        logged = {event.step: event.value for event in read_scalars(run, f"evaluation/{name}")}
        assert list(logged) == steps
        assert logged == pytest.approx({row["steps"]: row[name] for row in curve_of(read_evaluations(run))})


def test_a_run_goes_on_from_any_checkpoint_with_the_keys_that_may_change(tiny_run, tiny_data, tmp_path):
    """After the checkpoint of step 512. The evaluation before it stays; the one after it is replaced."""
    assert_logged(tiny_run, [0, 256, 512, 768])
    run = shutil.copytree(tiny_run, tmp_path / "run")
    data = {**tiny_data, "total_steps": 896, "checkpoints": {"every": 128, "keep": 4}, "torch_threads": 2}
    data["hyperparameters"] = {"n_steps": 32, "batch_size": 64, "n_epochs": 3, "gamma": 0.9}
    data["environment"] = {**tiny_data["environment"], "time_limit": 3.0}
    train(changed(data), resume=f"{run}@512", progress=False)
    assert_logged(run, [0, 256, 512, 768, 896])
    assert (run / "checkpoints" / "step_000000768.discarded").is_dir()
    assert [path.name for path in list_checkpoints(run)][-2:] == ["step_000000768", "step_000000896"]
    record = newest(run).record
    assert (record.steps, record.updates) == (896, 4 * 2 + 3 * 3)
    assert record.config.hyperparameters["gamma"] == 0.9
    assert record.config.environment.arguments["time_limit"] == 3.0


def test_the_same_seed_gives_the_same_weights_in_one_process_and_in_several(tiny_data, tmp_path):
    in_processes = tiny_data["environment"] | {"vectorization": "async"}
    runs = []
    for change in ({}, {"environment": in_processes}, {"seed": 1}):
        torch.randn(5)
        config = changed(tiny_data | {"total_steps": 128, "num_envs": 2}, **change)
        runs.append(train(config, run=tmp_path / str(len(runs)), progress=False))
    first, second, third = (newest(run).policy for run in runs)
    torch.testing.assert_close(first, second, atol=0.0, rtol=0.0)
    assert not all(torch.equal(first[key], third[key]) for key in first)


def test_a_killed_training_goes_on_from_its_last_checkpoint(tiny_data, tmp_path, capsys):
    """An environment kills the process by SIGKILL at its 220th step, after 880 steps of all environments."""
    config = changed(tiny_data, environment=tiny_data["environment"] | {"world": "deadly_220"}, total_steps=1280)
    (tmp_path / "deadly.yaml").write_text(dump_record(config))
    command, own = [sys.executable, str(ROOT / "train.py"), "--config", "deadly.yaml"], {"PYTHONPATH": str(ROOT)}
    killed = subprocess.run(command, cwd=tmp_path, env=os.environ | own, capture_output=True, text=True, timeout=300)
    assert killed.returncode == -9, killed.stderr
    (run,) = (tmp_path / "runs").iterdir()
    assert run.name.startswith("tiny__0__")
    source = find_checkpoint(run)
    steps = load_checkpoint(source, trust="tests").record.steps
    assert 880 - config.checkpoints.every <= steps <= 880
    evaluated = evaluated_steps(run)
    # Files of a save that was killed.
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (run / "checkpoints" / f".step_000000896.{platform.node()}.{dead.pid}.tmp").mkdir()

    assert main(["--resume", str(run), "--trust", ID, "--environment.world", "rooms"]) == 0
    assert str(run) in capsys.readouterr().out
    final = newest(run).record
    assert final.steps == 1280
    assert final.updates == 1280 // 128 * config.hyperparameters["n_epochs"]
    assert evaluated_steps(run)[: len(evaluated)] == evaluated
    assert evaluated_steps(run) == [0, 256, 512, 768, 1024, 1280]
    assert not list((run / "checkpoints").glob(".*"))
    events = read_scalars(run, "train/learning_rate")
    logged = [event.step for event in events]
    assert logged == sorted(set(logged))
    # The learning rate falls to one update's share of the initial rate.
    assert events[-1].value == pytest.approx(7e-4 / (1280 // 128))


@pytest.fixture(scope="module")
def often(tiny_data, tmp_path_factory):
    """Run with a checkpoint after each update."""
    config = changed(tiny_data, checkpoints={"every": 128, "keep": 9})
    return train(config, run=tmp_path_factory.mktemp("runs") / "often", progress=False)


@pytest.mark.parametrize("step", [1, 100])
def test_ctrl_c_saves_the_state_before_the_running_rollout(step, often, tiny_data, tmp_path, monkeypatch, capsys):
    """At the 100th step of each environment, 384 steps have been learned from; checkpoints are due every 256."""
    monkeypatch.chdir(tmp_path)
    interrupted = tiny_data["environment"] | {"world": f"interrupted_{step}"}
    (tmp_path / "tiny.yaml").write_text(dump_record(changed(tiny_data, environment=interrupted)))
    assert main(["--config", "tiny.yaml"]) == 130
    (run,) = Path("runs").iterdir()
    steps = 0 if step == 1 else 384
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.partition(": ")[2] == f"stopped at step {steps} (saved); resume with --resume {run} --trust {ID}"
    saved = newest(run)
    assert saved.record.steps == steps
    whole = load_checkpoint(often / "checkpoints" / f"step_{steps:09d}", trust="tests")
    for name in ("numpy_random", "evaluations"):
        assert getattr(saved.record, name) == getattr(whole.record, name)
    for mine, theirs in ((saved.policy, whole.policy), (saved.training, whole.training)):
        torch.testing.assert_close(mine, theirs, atol=0.0, rtol=0.0)


def test_a_training_that_diverges_says_so_and_leaves_good_checkpoints(tiny_data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(dump_record(changed(tiny_data)))
    assert main(["--config", "tiny.yaml", "--hyperparameters.learning-rate", "1e30"]) == 2
    (run,) = Path("runs").iterdir()
    good = run / "checkpoints" / "step_000000000"
    assert list_checkpoints(run) == [good]
    load_checkpoint(good, trust="tests")
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.partition(": ")[2] == (
        "the training diverged at step 128: the network's weights or outputs are not finite; "
        "lower hyperparameters.learning_rate (1e+30) or the weights of large rewards; "
        f"resume from {good} with --resume {good} --trust {ID}"
    )
    lower = ["--hyperparameters.learning-rate", "1e-3", "--total-steps", "128"]
    assert main(["--resume", str(good), "--trust", ID, *lower]) == 0


def test_weights_and_outputs_that_overflow_are_not_finite_without_an_error_of_torch(tiny_config):
    with contextlib.closing(make_vec_env(tiny_config)) as env:
        model = untrained(tiny_config, env)
        assert is_finite(model)  # before the first episode
        model._last_obs = env.reset()
        assert is_finite(model)
        weight = model.policy.action_net.weight.data
        for number in (1e38, np.nan):
            weight[:] = number
            assert not is_finite(model)


def test_a_reward_that_is_not_finite_is_named_before_anything_is_learned_from_it(tiny_data, tmp_path):
    broken = tiny_data["environment"] | {"world": "priceless_70"}
    with pytest.raises(ValueError, match=r"diverged at step 280: a reward of sub-environment 0 is nan; .*resume from"):
        train(changed(tiny_data, environment=broken), run=tmp_path / "run", progress=False)
    assert newest(tmp_path / "run").record.steps == 256


@pytest.mark.filterwarnings("ignore:.*ERROR")  # Gymnasium reports errors of processes by warnings
def test_an_environment_that_fails_in_another_process_is_heard(tiny_data, tmp_path):
    broken = tiny_data["environment"] | {"world": "broken_6", "vectorization": "async"}
    with pytest.raises(RuntimeError, match="the floor gave way"):
        train(changed(tiny_data, environment=broken, num_envs=1), run=tmp_path / "run", progress=False)


def test_a_run_to_resume_has_its_own_folder(tiny_run, tiny_config, tmp_path):
    with pytest.raises(ValueError, match=f"a run to resume has its own folder, {tiny_run}: leave out run"):
        train(tiny_config, run=tmp_path / "run", resume=tiny_run, progress=False)


@pytest.mark.parametrize(("name", "message"), [("guess", "frontier rule guess: .*'gain'"), ("Unread", "'speed'")])
def test_a_wrong_reference_is_named_before_the_first_evaluation(name, message, tiny_data, tmp_path, monkeypatch):
    monkeypatch.setattr(Evaluator, "references", lambda *_: pytest.fail("an evaluation has begun"))
    environment = {"world": "pimouse_arena", "control_hz": 5, "time_limit": 2}
    references = {"episodes": 1, "references": ["nearest", f"tests.own_code:{name}"]}
    config = changed(tiny_data, environment=environment, evaluation=references)
    with pytest.raises((ValueError, AttributeError), match=message):
        train(config, run=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
