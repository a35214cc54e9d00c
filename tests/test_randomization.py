import json
import pickle
from importlib.util import find_spec
from operator import attrgetter
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.randomization import RANDOMIZABLE, Randomization
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.explore import Explore
from tests.rollouts import rollout
from tests.rooms import BURGER, square_room
from tests.test_core import QUICK
from tests.vector.test_vector import RANGES

BULLET = pytest.param("bullet", marks=pytest.mark.skipif(not find_spec("pybullet"), reason="needs PyBullet"))
ROOM = {"world": square_room(1.5), "start": (0.0, 0.0, 0.0), "physics": "kinematic", "slam": "odometry"}
HALL = {**ROOM, "world": square_room(10.0)}


def fixed(**values):
    """Return ranges of one value each; double underscores stand for dots."""
    return {name.replace("__", "."): (value, value) for name, value in values.items()}


def test_values_lie_in_their_ranges_and_differ_between_episodes():
    env = LidarEnv(Explore, **QUICK, randomize=RANGES)
    drawn = [env.reset(seed=0)[1]["randomized"]] + [env.reset()[1]["randomized"] for _ in range(20)]
    for name, (low, high) in RANGES.items():
        values = np.array([values[name] for values in drawn])
        assert ((low <= values) & (values <= high)).all()
        assert len(set(values.tolist())) == len(values)
        assert np.ptp(values) > 0.5 * (high - low)


@pytest.mark.parametrize("physics", ["kinematic", BULLET])
def test_same_seed_same_values_and_bytes_in_copies_and_whatever_the_order_of_the_names(physics):
    env, other = (
        gymnasium.make("lidarnaut/Explore-v0", **{**QUICK, "physics": physics}, randomize=ranges)
        for ranges in (RANGES, dict(reversed(RANGES.items())))
    )
    assert json.loads(env.spec.to_json())["kwargs"]["randomize"]["max_v"] == [0.15, 0.22]
    first = rollout(env, 3, 8)
    assert first[-1][-1]["randomized"] == first[0][1]["randomized"]
    assert rollout(env, 4, 3)[0][1]["randomized"] != first[0][1]["randomized"]
    for each in (env, other, pickle.loads(pickle.dumps(env))):
        assert data_equivalence(rollout(each, 3, 8), first, exact=True)
        each.close()


def test_the_world_the_start_and_the_task_are_those_without_randomization():
    arguments = {key: value for key, value in QUICK.items() if key != "control_hz"}
    plain, randomized = (
        gymnasium.make("lidarnaut/Navigate-v0", **arguments, randomize=r).unwrapped for r in ({}, RANGES)
    )
    assert "randomized" not in plain.reset(seed=5)[1]
    assert set(randomized.reset(seed=5)[1]["randomized"]) == set(RANGES)
    np.testing.assert_array_equal(plain.world.segments, randomized.world.segments)
    assert plain.truths[0].state.pose == randomized.truths[0].state.pose
    assert plain.task.goal == randomized.task.goal


def test_lidars_are_as_drawn_also_for_coverage_and_the_robot_is_told_nothing():
    def scan(**values):
        env = LidarEnv(Explore, **ROOM, randomize=fixed(**values))
        observation, _ = env.reset(seed=0)
        assert env.robot_params == env.robots[0].params == BURGER
        return observation["scan"] * BURGER.lidar.range_max

    exact, noisy = scan(lidar__noise_std=0.0), scan(lidar__noise_std=0.1)
    assert np.std(noisy - exact) == pytest.approx(0.1, rel=0.15)
    assert np.mean(scan(lidar__dropout=0.5) == 0.0) == pytest.approx(0.5, abs=0.08)
    turned = scan(lidar__noise_std=0.0, lidar__mount__yaw=np.deg2rad(10.0))
    np.testing.assert_allclose(turned[:-10], exact[10:], atol=1e-3)
    env = LidarEnv(Explore, **HALL, randomize=fixed(lidar__mount__x=0.2, lidar__mount__yaw=0.3))
    env.reset(seed=0)
    seen = env.task.coverage._true_scan(env.reading.ranges, Pose2D(1.0, 2.0, 0.0))
    assert (seen.x, seen.y, seen.theta) == pytest.approx((1.2, 2.0, 0.3 + BURGER.lidar.angle_min))


def drive_ahead(physics, steps, **values):
    """Drive straight on with fixed values; return the environment and the last `info`."""
    env = LidarEnv(Explore, **{**HALL, "physics": physics}, randomize=fixed(**values))
    out = rollout(env, 0, steps, lambda _: np.array([1.0, 0.0], dtype=np.float32))
    env.close()
    return env, out[-1][4]


@pytest.mark.parametrize("physics", ["kinematic", BULLET])
def test_larger_wheels_drive_farther_than_odometry_says(physics):
    env, info = drive_ahead(physics, 50, drive__wheel_radius=0.0363, drive__slip_std=0.0)
    assert info["path_length"] / env.belief.pose.x == pytest.approx(1.1, abs=0.01)


def test_wheels_without_grip_spin():
    pytest.importorskip("pybullet")
    driven = [drive_ahead("bullet", 20, drive__friction=friction)[1]["path_length"] for friction in (1.0, 0.002)]
    assert driven[1] < 0.5 * driven[0]


@pytest.mark.parametrize("name", RANDOMIZABLE)
def test_every_name_is_a_parameter_of_robots(name):
    robot = load_robot("mpo_500")
    value = {"drive.track": 0.7, "drive.wheel_radius": 0.12}.get(name, 0.01)
    changed = Randomization(
        {name: (value, value)}, robot, SimpleNamespace(ignored=(), set_robot=lambda changed: None)
    ).robot({name: value})
    assert attrgetter(name)(changed) == value
    assert changed != robot
