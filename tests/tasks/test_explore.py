import subprocess
import sys
from dataclasses import replace

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
from tests.rooms import BURGER
from tests.test_core import QUICK


# Random starts that hit a moving obstacle, which `reset` refused.
@pytest.mark.parametrize(
    ("world", "seed"), [("turtlebot3_stage_3", 4), ("turtlebot3_stage_4", 18), ("turtlebot3_dqn_stage3", 21)]
)
def test_reset_keeps_clear_of_people(world, seed):
    env = LidarEnv(Explore, world=world, physics="kinematic", slam="truth")
    env.reset(seed=seed)
    assert not env.step(np.zeros(2, dtype=np.float32))[4]["collisions"]


def hall(length):
    near = [(0, 2, 0, 0), (0, 0, 8, 0), (0, 2, 8, 2), (3, 0, 3, 0.8)]
    far = [(8, 0, length, 0), (8, 2, length, 2), (length, 0, length, 2)]
    walls = np.array([*near, *far], dtype=float)
    return World("hall", walls, np.empty((0, 3)), (Pose2D(1.0, 1.0, 0.0),), (0.0, 0.0, length, 2.0))


@pytest.mark.parametrize(
    ("id", "steps", "arguments"),
    [
        ("Explore", 12, {"observations": (*PARTS, "home"), "return_home": True}),
        ("ExploreFrontiers", 3, {}),
        ("ExploreTeam", 12, {"num_robots": 2, "observations": (*PARTS, "teammates")}),
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


def test_driving_into_a_wall_is_counted_and_does_not_end_the_episode():
    env = LidarEnv(Explore, **QUICK, slam="truth")
    env.reset(seed=0)
    ahead = np.array([1.0, 0.0], dtype=np.float32)
    infos = [env.step(ahead)[4] for _ in range(150)]
    assert infos[-1]["collisions"] >= 1
    assert min(info["rewards"]["collision"] for info in infos) < 0


def test_ground_truth_has_no_pose_error_and_tinyslam_keeps_the_heading_that_wheels_lose():
    position, heading = {}, {}
    robot = replace(BURGER, odometry=replace(BURGER.odometry, uses_gyro=False))
    for slam in ("truth", "odometry", "tinyslam"):
        env = LidarEnv(Explore, **QUICK, slam=slam, robot=robot)
        ends = np.array([rollout(env, seed, 200)[-1][4]["pose_error"] for seed in range(4)])
        position[slam], heading[slam] = ends.mean(axis=0)
    assert position["truth"] + heading["truth"] < 1e-9
    assert position["odometry"] > 1e-3
    assert position["tinyslam"] < 0.05
    assert heading["tinyslam"] < 0.3 * heading["odometry"]


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
