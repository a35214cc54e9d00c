"""`NUMBA_DISABLE_JIT=1`: environments run as plain Python, with equal results."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.navigation import CANDIDATE
from lidarnaut.envs.navigation.controllers.navigator_kernels import NAVIGATOR
from lidarnaut.envs.simulation.records import ROW
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
import numpy as np
from lidarnaut.envs.slam.matching.branch_and_bound import Grid, total_at
from tests.package.test_without_jit import CASES, play
pickle.dump({name: play(cases) for name, cases in CASES.items()}, open(sys.argv[1], "wb"))
print(total_at(np.full(4, 200, np.uint8), Grid(np.arange(4, dtype=np.int32)[None], np.array([4]), 0, 0), 0, 0))
"""


def play(cases):
    played = []
    for id, arguments in cases:
        env = gymnasium.make(f"lidarnaut/{id}-v0", **arguments)
        played.append((env.reset(seed=3)[0], 0.0))
        env.action_space.seed(1)
        for _ in range(2):
            observation, reward, *_ = env.step(env.action_space.sample())
            played.append((observation, reward))
        env.close()
    return played


def test_environments_run_as_with_compiled_kernels_and_sums_do_not_overflow(tmp_path):
    """Warnings are errors."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", PROGRAM, str(tmp_path / "played")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["800"]
    played = pickle.loads((tmp_path / "played").read_bytes())
    for name, cases in CASES.items():
        for (observation, reward), (expected, expected_reward) in zip(played[name], play(cases), strict=True):
            assert reward == pytest.approx(expected_reward, abs=1e-4), name
            assert observation.keys() == expected.keys()
            for part in expected:
                np.testing.assert_allclose(observation[part], expected[part], atol=1e-4, err_msg=f"{name}, {part}")


def test_fields_of_records_are_no_attributes_of_numpy():
    """Without compiler `record.name` is NumPy's own attribute of that name; `size` is read as `record["size"]`."""
    assert [name for name in (*CANDIDATE.names, *NAVIGATOR.names, *ROW.names) if hasattr(np.record, name)] == ["size"]
