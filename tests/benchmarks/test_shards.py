import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from lidarnaut.baselines import EXPLORERS, RandomExplorer
from lidarnaut.benchmarks.arena.publish import print_results, publish
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.workers import NOT_RUN
from lidarnaut.envs.files import parse_record, read_record
from lidarnaut.envs.slam import SLAM_NAMES
from lidarnaut.envs.worlds import WORLD_NAMES
from lidarnaut.evaluate_command import main
from tests.benchmarks.explorations import deterministic

ROOT = Path(__file__).parents[2]
SETTINGS = Settings(
    policies=("nearest", "random"),
    worlds=("pimouse_arena", "turtlebot3_dqn_stage1"),
    episodes=2,
    physics=("kinematic",),
    time_limit=2.0,
)
OPTIONS = ["--policies", "nearest", "random", "--physics", "kinematic", "--time-limit", "2"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    evaluation = Evaluation(SETTINGS, tmp_path_factory.mktemp("whole"))
    assert (evaluation.total, evaluation.run()) == (8, [])
    return evaluation


def test_shards_partition_the_evaluation_and_merge_to_the_same(whole, tmp_path):
    parts = [Evaluation(SETTINGS, tmp_path, f"{k}/3") for k in (1, 2, 3)]
    assert sum(part.total for part in parts) == whole.total
    missing = {failure.key for failure in Evaluation(SETTINGS, tmp_path).missing()}
    for part in parts:
        assert part.run() == []
        # All runs from one start are in one shard.
        left = {failure.key for failure in Evaluation(SETTINGS, tmp_path).missing()}
        assert not {key[1:3] for key in missing - left} & {key[1:3] for key in left}
        missing = left
    assert {path.name for path in tmp_path.glob("*.csv")} == {f"episodes-{k}of3.csv" for k in (1, 2, 3)}
    together = Evaluation(SETTINGS, tmp_path)
    assert (together.done, together.missing()) == (whole.total, [])
    assert deterministic(together.rows()) == deterministic(whole.rows())


def test_shards_of_two_totals_do_not_share_a_folder(tmp_path):
    first, late = Evaluation(SETTINGS, tmp_path, "1/2"), Evaluation(SETTINGS, tmp_path, "1/3")
    assert first.run() == []
    with pytest.raises(ValueError, match=rf"{tmp_path} holds shards I/2, and --shard is 1/3"):
        late.run()
    assert {path.name for path in tmp_path.glob("*.csv")} == {"episodes-1of2.csv"}
    for rest in ("2/2", None):
        assert Evaluation(SETTINGS, tmp_path, rest).run() == []
    assert len(Evaluation(SETTINGS, tmp_path).rows()) == 8


class Fragile(RandomExplorer):
    def reset(self, robot, control_period, rng):
        super().reset(robot, control_period, rng)
        self._is_broken = rng.integers(2**32) == np.random.default_rng([1, 1]).integers(2**32)

    def act(self, reading, belief):
        if self._is_broken:
            raise ZeroDivisionError("no way out")
        return super().act(reading, belief)


def test_a_crash_costs_its_episode_alone_and_says_so(tmp_path, monkeypatch, capsys, no_overview):
    monkeypatch.setitem(EXPLORERS, "fragile", Fragile)
    settings = ["--policies", "fragile", "random", "--worlds", "pimouse_arena", "turtlebot3_dqn_stage1", "--episodes"]
    settings += ["2", "--physics", "kinematic", "--time-limit", "2", "--out", str(tmp_path)]
    assert main(settings) == 1
    said = " ".join(capsys.readouterr().err.split())
    for world in ("pimouse_arena with raspimouse", "turtlebot3_dqn_stage1 with turtlebot3_burger"):
        assert f"1 episodes of fragile in {world} could not be run: ZeroDivisionError: no way out (test_sh" in said
    page = (tmp_path / "leaderboard.md").read_text()
    assert "| ZeroDivisionError: no way out" in page
    assert "4 of 6 episodes" in page  # from the two starts of both policies

    # After the repair, the command runs only the missing episodes.
    lines = (tmp_path / "episodes.csv").read_text().splitlines()
    assert len(lines) == 1 + 6
    monkeypatch.setitem(EXPLORERS, "fragile", RandomExplorer)
    assert main(settings) == 0
    assert (tmp_path / "episodes.csv").read_text().splitlines()[:7] == lines
    assert "could not be run" not in (tmp_path / "leaderboard.md").read_text().lower()


def test_a_robot_that_does_not_fit_does_not_end_the_suite(tmp_path):
    changes = {"worlds": ("pimouse_arena", "maze"), "robots": ("tugbot",), "episodes": 1}
    evaluation = Evaluation(SETTINGS.model_copy(update=changes), tmp_path)
    failures = evaluation.run()
    assert {failure.key.world for failure in failures} == {"pimouse_arena"}
    assert all("tugbot" in failure.reason and "does not fit" in failure.reason for failure in failures)
    assert {row["world"] for row in evaluation.rows()} == {"maze"}
    assert evaluation.missing() == failures


def test_nothing_is_run_for_a_report(whole, tmp_path, no_overview):
    shutil.copytree(whole.folder, tmp_path, dirs_exist_ok=True)
    table = (tmp_path / "episodes.csv").read_text()
    options = [*OPTIONS, "--worlds", *SETTINGS.worlds, "--episodes", "3"]
    options += ["--out", str(tmp_path), "--report"]
    assert main(options) == 1
    assert (tmp_path / "episodes.csv").read_text() == table
    assert NOT_RUN in (tmp_path / "leaderboard.md").read_text()


def test_the_arena_of_the_project_covers_everything():
    settings = read_record(ROOT / "configs" / "arena.yaml", Settings)
    # Families are listed only if they have results.
    assert set(settings.worlds) == {*WORLD_NAMES, "rooms", "maze", "warehouse", "caves"}
    learned = {f"learned{name}:pretrained/frontiers" for name in ("=learned", "_pursuit=pursuit")}
    assert set(settings.policies) == {*EXPLORERS, *learned, "twist=ppo:pretrained/twist"}
    settings = read_record(ROOT / "configs" / "experiments" / "mapping_error.yaml", Settings)
    assert set(settings.slam) == set(SLAM_NAMES)


def test_groups_stand_for_their_worlds_and_mistakes_are_named():
    settings = parse_record({"policies": ["random"], "worlds": ["library", "barn_test"]}, "mem", Settings)
    assert settings.worlds == (*WORLD_NAMES, *(f"barn:{number}" for number in range(0, 300, 6)))
    for data, message in (
        ({"episode": 3}, r"mem: unknown key 'episode' \(did you mean 'episodes'\?\)"),
        ({"worlds": ["maze", "families"]}, "worlds: must be unique"),
        ({"physics": 3}, "physics: .*tuple, got 3"),
    ):
        with pytest.raises(ValueError, match=message):
            parse_record({"policies": ["nearest"], "worlds": ["maze"]} | data, "mem", Settings)


def test_explorers_that_share_no_start_are_reported_side_by_side(whole, tmp_path, capsys, no_overview):
    shutil.copytree(whole.folder, tmp_path, dirs_exist_ok=True)
    header, *lines = (tmp_path / "episodes.csv").read_text().splitlines()
    kept = [line for line in lines if line.startswith("nearest") == (",0," in line[:60])]
    assert 2 <= len(kept) < len(lines)
    (tmp_path / "episodes.csv").write_text("\n".join([header, *kept]) + "\n")
    publish(Evaluation(SETTINGS, tmp_path))
    print_results(Evaluation(SETTINGS, tmp_path), Console(stderr=True))
    assert len(re.findall(r"(?m)^ ?(nearest|random) ", capsys.readouterr().out)) == 2
    assert "World by world" in (tmp_path / "report.html").read_text()
    assert "0 of 4 episodes" in (tmp_path / "leaderboard.md").read_text()


def test_the_bound_uses_the_true_pose_whatever_it_bounds(tmp_path):
    changes = {"policies": ("oracle", "nearest"), "worlds": ("pimouse_arena",), "slam": ("odometry",)}
    settings = SETTINGS.model_copy(update=changes)
    evaluation = Evaluation(settings, tmp_path)
    assert evaluation.run() == []
    errors = {row["policy"]: row["position_rmse"] for row in evaluation.rows()}
    assert errors["oracle (ground truth)"] < 1e-9 < errors["nearest"]
    assert {row["slam"] for row in evaluation.rows()} == {"odometry"}
