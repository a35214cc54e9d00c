import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import Trace
from lidarnaut.evaluate_command import main
from tests import own_code
from tests.benchmarks.explorations import read_rows

ROOT = Path(__file__).parents[2]
POLICIES = ("Circling", "ahead", "Model", "first_frontier", "MaskedModel")
BRIEF = ["--episodes", "1", "--physics", "kinematic", "--time-limit", "6"]


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    shutil.copy(own_code.__file__, tmp_path / "own_explorers.py")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("own_explorers", None)
    sys.path[:] = [path for path in sys.path if path != str(tmp_path)]


def test_explorers_and_policies_of_a_users_module_enter_the_arena_which_logs_progress_if_asked(own_folder):
    own = [f"own_explorers:{name}" for name in POLICIES[:-1]]
    policies = ["nearest", *own, "mine=own_explorers:MaskedModel", "own_explorers:Leaving"]
    # In another process with two workers, which log as well: the module is found in the current folder.
    command = [sys.executable, str(ROOT / "evaluate.py"), "--policies", *policies, "--worlds", "turtlebot3_world", "-v"]
    options = ["--episodes", "1", "--physics", "kinematic", "--time-limit", "12", "--jobs", "2", "--out", "out"]
    options += ["--slam", "usual", "own_explorers:Failing"]
    # A shard draws no page, which takes seconds.
    done = subprocess.run([*command, *options, "--shard", "1/1"], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    said = r"lidarnaut.baselines.episode: NearestExplorer, seed 0, 10 s: explored_fraction 0\.\d{3}, goal \[.*\], "
    assert len(re.findall(said + r"\d+ frontiers, 0 blacklisted", done.stderr)) == 1
    assert done.stderr.count("Circling, seed 0, 10 s: explored_fraction 0.") == 1
    for culprit in (
        r"of own_explorers:Leaving in turtlebot3_world with \w+ could not be run: SystemExit: done",
        r"in turtlebot3_world with \w+ and own_explorers:Failing could not be run: TypeError: no numbers",
    ):
        assert re.search(culprit + r" \(own_explorers.py, line \d+\)", " ".join(done.stderr.split())), done.stderr
    rows = read_rows(own_folder / "out")
    assert {row["policy"] for row in rows} == {"nearest", *own, "mine"}
    for row in rows:
        assert 0.0 < float(row["explored_fraction"]) <= 1.0, row
        assert float(row["path_length"]) > 0.3, row
    # A trace at decision level also has the time of each cell's first observation.
    for path in (own_folder / "out" / "episodes").iterdir():
        trace = Trace.load(path)
        assert ((trace.grid.data >= 0) == (trace.known_since < 1e9)).all()


def test_whoever_takes_ground_truth_is_a_bound_in_every_row_and_page(own_folder, no_overview):
    policies = ["nearest", "own_explorers:Spy", "oracle2=own_explorers:Spy"]
    out = own_folder / "out"
    command = [*BRIEF, "--policies", *policies, "--worlds", "pimouse_arena", "turtlebot3_dqn_stage1", "--out", str(out)]
    assert main(command) == 0
    names = ["own_explorers:Spy (ground truth)", "oracle2 (ground truth)"]
    assert {row["policy"] for row in read_rows(out)} == {"nearest", *names}
    page, report = (out / "leaderboard.md").read_text(), (out / "report.html").read_text()
    assert "| nearest |" in page
    for name in names:
        assert f"| bound: {name} |".replace("_", "\\_") in page
        for text in (page.replace("\\_", "_"), report):
            shown = text.split("Command</th>" if text is report else "| Command |")[0]
            assert shown.count(name.removesuffix(" (ground truth)")) == shown.count(name) > 3


GOALS = ["--id", "lidarnaut/ReachGoal-v0", "--worlds", "rooms", "hall", *BRIEF]


def test_what_observes_ground_truth_or_says_that_it_uses_some_is_a_bound_too(own_folder, no_overview):
    uses = [f"own_explorers:{name}" for name in ("FollowsTruth", "SeesTruth", "Admits")]
    uses.append("mine=own_explorers:SeesTruth")
    policies, out = ["pursuit", "own_explorers:FollowsPlan", *uses, "ppo:pretrained/reach"], own_folder / "out"
    assert main([*GOALS, "--policies", *policies, "--out", str(out)]) == 0
    names = {f"{name.partition('=')[0]} (ground truth)" for name in uses}
    rows = read_rows(out)
    assert {row["policy"] for row in rows} == {"pursuit", "own_explorers:FollowsPlan", *names, "ppo:pretrained/reach"}
    assert {row["slam"] for row in rows} == {"odometry"}
    page = (out / "leaderboard.md").read_text().replace("\\_", "_")
    for name in names:
        assert f"| bound: {name} |" in page, name
    assert "| ppo:pretrained/reach |" in page
    assert "4. " not in page
    goals = [Trace.load(path).goal for path in (out / "episodes").iterdir()]
    assert len(np.unique(goals, axis=0)) == 2  # of two worlds
    assert np.linalg.norm(goals, axis=1).min() > 1.0


def test_the_observation_of_the_environment_marks_those_that_look_at_it(own_folder, no_overview):
    out, shortest = own_folder / "out", ["--arguments.observations", "{carrot: {path: shortest}}"]
    policies = ["pursuit", "own_explorers:shown", "own_explorers:FollowsPlan", "own_explorers:Circling", "random"]
    assert main([*GOALS, *shortest, "--policies", *policies, "--out", str(out)]) == 0
    marked = {row["policy"] for row in read_rows(out)} - set(policies)
    assert marked == {"own_explorers:shown (ground truth)"}


def test_the_objects_themselves_can_be_given_in_python(tmp_path):
    given = {
        **{"circling": own_code.Circling, "model": own_code.Model(), "frontier_0": own_code.first_frontier},
        **{"home": own_code.WORLD, "mouse": own_code.ROBOT, "mapper": own_code.my_slam},
    }
    brief = {"physics": ("kinematic",), "episodes": 1, "time_limit": 4.0}
    policies = "circling", "model", "frontier_0", "random"
    settings = Settings(policies=policies, worlds=("home",), robots=("mouse",), slam=("mapper",), **brief)
    here, there = (Evaluation(settings, tmp_path / name, custom=given) for name in ("here", "there"))
    assert here.run() == there.run(jobs=2) == []
    both = [[(row["policy"], row["path_length"], row["robot"]) for row in each.rows()] for each in (here, there)]
    assert both[0] == both[1]
    assert [row[0] for row in both[0]] == list(settings.policies)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--policies", "own_explorers:leave"], [": own_explorers:leave: SystemExit: 3 (own_explorers.py, line "]),
        (["--slam", "own_explorers:leave"], [": own_explorers:leave in pimouse_arena: SystemExit: 3 (own_explorers.p"]),
        (["--slam", "own_explorers:Circling"], [": own_explorers:Circling in pimouse_arena: TypeError: Circling() ta"]),
        (["--policies", "own_explorers:Circlign"], ["own_explorers", "no attribute", "did you mean 'Circling'"]),
        (["--policies", "nowhere.at_all:Mine"], ["no module 'nowhere'"]),
        (["--policies", "own_explorers:guess"], ["frontier rule guess: ValueError: unknown", "'gain'", "visible"]),
        (["--policies", "own_explorers:first_two"], ["frontier rule first_two must return", "scores", "got shape"]),
        (["--policies", "own_explorers:unknown"], ["frontier rule unknown must return", "scores without NaN"]),
        (["--policies", "own_explorers:Unread"], ["own_explorers:Unread: AttributeError", "own_explorers.py, line "]),
        (["--arguments.reward", "own_explorers:NanReward"], ["reward NanReward must return finite", "'half': "]),
        (["--policies", "own_explorers:WORLD"], ["is not an explorer", "predict(observation)"]),
        (["--policies", "nearest=own_explorers:Circling"], ["must differ from classic policies"]),
    ],
)
def test_what_cannot_be_made_is_named_before_any_episode(own_folder, capsys, options, says):
    assert main([*BRIEF, "--policies", "nearest", "--worlds", "pimouse_arena", "--out", "out", *options]) == 2
    message = " ".join(capsys.readouterr().err.split())
    assert all(text in message for text in says), message
