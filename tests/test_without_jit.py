"""`NUMBA_DISABLE_JIT=1`: environments run as plain Python, with equal results."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import lidarnaut  # noqa: F401
from lidarnaut.envs.navigation import CANDIDATE
from lidarnaut.envs.navigation.controllers.navigator_kernels import NAVIGATOR
from lidarnaut.envs.slam import SLAM_NAMES

EXPLORE = "Explore"
CASES = {
    "every SLAM": [(EXPLORE, {"slam": slam, "physics": "kinematic"}) for slam in SLAM_NAMES],
    "people and tracks": [
        ("ReachGoal", {"physics": "kinematic", "people": 4}),
        (EXPLORE, {"people": "3?model=orca", "observations": ["scan", "tracks", "trajectories"]}),
    ],
    "AMCL": [("Navigate", {"physics": "kinematic", "people": 2})],
    "decisions": [("ExploreFrontiers", {"physics": "kinematic", "people": 2})],
    "a team, bullet": [("ExploreTeam", {}), ("ReachClutter", {})],
}
PROGRAM = """
import pickle, sys
from tests.test_without_jit import CASES, play
pickle.dump(play(CASES[sys.argv[1]]), open(sys.argv[2], "wb"))
"""


def play(cases):
    played = []
    for id, arguments in cases:
        env = gymnasium.make(f"lidarnaut/{id}-v0", **arguments)
        played.append((env.reset(seed=3)[0], 0.0))
        env.action_space.seed(1)
        for _ in range(3):
            observation, reward, *_ = env.step(env.action_space.sample())
            played.append((observation, reward))
        env.close()
    return played


def run(program, *arguments):
    """Warnings are errors."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", program, *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", CASES)
def test_environments_run_as_with_compiled_kernels(name, tmp_path):
    run(PROGRAM, name, tmp_path / "played")
    played = pickle.loads((tmp_path / "played").read_bytes())
    for (observation, reward), (expected, expected_reward) in zip(played, play(CASES[name]), strict=True):
        assert reward == pytest.approx(expected_reward, abs=1e-4)
        assert observation.keys() == expected.keys()
        for part in expected:
            np.testing.assert_allclose(observation[part], expected[part], atol=1e-4, err_msg=part)


def test_sums_do_not_overflow():
    program = """
import numpy as np
from lidarnaut.envs.slam.matching.branch_and_bound import Grid, total_at
print(total_at(np.full(4, 200, np.uint8), Grid(np.arange(4, dtype=np.int32)[None], np.array([4]), 0, 0), 0, 0))
"""
    assert run(program).split() == ["800"]


def test_fields_of_records_are_no_attributes_of_numpy():
    """Without compiler `record.name` is NumPy's own attribute of that name; `size` is read as `record["size"]`."""
    assert [name for name in (*CANDIDATE.names, *NAVIGATOR.names) if hasattr(np.record, name)] == ["size"]
