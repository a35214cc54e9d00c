import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence as same

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations import PARTS
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.worlds import World
from tests.rollouts import rollout
from tests.test_core import QUICK


def hall(length):
    near = [(0, 2, 0, 0), (0, 0, 8, 0), (0, 2, 8, 2), (3, 0, 3, 0.8)]
    far = [(8, 0, length, 0), (8, 2, length, 2), (length, 0, length, 2)]
    walls = np.array([*near, *far], dtype=float)
    return World("hall", walls, np.empty((0, 3)), (Pose2D(1.0, 1.0, 0.0),), (0.0, 0.0, length, 2.0))


@pytest.mark.parametrize(
    ("id", "steps", "arguments"),
    [
        ("Explore", 7, {"observations": (*PARTS, "home"), "return_home": True}),
        ("ExploreFrontiers", 3, {}),
        ("ExploreTeam", 7, {"num_robots": 2, "observations": (*PARTS, "teammates")}),
    ],
)
def test_observations_tell_neither_the_time_limit_nor_what_is_out_of_sight(id, steps, arguments):
    def observe(length, **limit):
        common = {"world": hall(length), "physics": "kinematic", "start": "spawn", **arguments}
        env = gymnasium.make(f"lidarnaut/{id}-v0", **common, **limit)
        env.action_space.seed(0)
        return [env.reset(seed=0)[0], *(env.step(env.action_space.sample())[0] for _ in range(steps))]

    first = observe(14.0)
    assert same(first, observe(14.0, time_limit=3000.0))
    assert same(first, observe(40.0))


IMPORT = """
import sys, lidarnaut, gymnasium
from importlib.util import find_spec
assert not {"torch", "numba", "stable_baselines3", "scipy", "tyro"} & sys.modules.keys(), sorted(sys.modules)
gymnasium.make("lidarnaut/Explore-v0", physics="kinematic")
assert not {"torch", "stable_baselines3", "pygame", "matplotlib", "pybullet"} & sys.modules.keys(), sorted(sys.modules)
if find_spec("torch"):
    from lidarnaut import train, evaluate
    assert callable(train) and callable(evaluate) and "torch" not in sys.modules
"""


def test_import_registers_the_environments_and_loads_no_heavy_library():
    subprocess.run([sys.executable, "-c", IMPORT], check=True)


def test_works_without_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    rollout(LidarEnv(Explore, **QUICK), 0, 3)
    with pytest.raises(ImportError, match="kinematic"):
        LidarEnv(Explore, physics="bullet").reset(seed=0)
