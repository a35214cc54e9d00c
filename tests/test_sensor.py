"""Sensors of the user's own."""

import pickle

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from envs.core import LidarEnv
from envs.tasks.explore import Explore, ExploreTeam
from tests.test_core import QUICK


class Beacon:
    """The distance to the origin of the world, with noise."""

    name = "beacon"
    shape = (1,)

    def reset(self, world, rng):
        self._rng = rng

    def measure(self, simulator, robot):
        return np.hypot(*simulator.states[robot].pose[:2]) + 0.1 * self._rng.standard_normal(1)


class Cliff(Beacon):
    name = "cliff"

    def measure(self, simulator, robot):
        return np.array([float(robot)])


def drive(env, steps=10):
    env.reset(seed=1)
    seen = []
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        seen.append([dict(robot.reading.extra) for robot in env.robots])
    return seen


def test_readings_hold_what_sensors_measure_and_the_same_seed_repeats_it():
    first, again = (drive(LidarEnv(Explore, sensors=[Beacon, "tests.test_sensor:Cliff"], **QUICK)) for _ in range(2))
    assert first == again
    assert set(first[0][0]) == {"beacon", "cliff"}
    assert len({float(step[0]["beacon"][0]) for step in first}) == 10


def test_an_episode_is_the_same_with_and_without_sensors():
    with_sensor, without = LidarEnv(Explore, sensors=[Beacon()], **QUICK), LidarEnv(Explore, **QUICK)
    assert data_equivalence(with_sensor.reset(seed=4)[0], without.reset(seed=4)[0])


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_each_robot_of_a_team_has_its_own_measurement(physics):
    env = LidarEnv(ExploreTeam, sensors=[Cliff], **{**QUICK, "physics": physics})
    assert [one["cliff"].tolist() for one in drive(env, 1)[0]] == [[0.0], [1.0]]
    env.close()


def test_an_environment_with_sensors_pickles_between_steps():
    env = LidarEnv(Explore, sensors=[Beacon()], **QUICK)
    drive(env, 3)
    copy = pickle.loads(pickle.dumps(env))
    for one in (env, copy):
        one.step(np.zeros(2, dtype=np.float32))
    assert env.reading.extra == copy.reading.extra


@pytest.mark.parametrize(
    ("sensors", "culprit"),
    [
        ("beacon", "sensors must be a sequence"),
        ([Beacon, Beacon], "names of their own"),
        ([object()], "lacks name, shape, reset, measure"),
        (["nowhere"], "unknown sensor 'nowhere'"),
    ],
)
def test_what_is_no_sensor_is_named(sensors, culprit):
    with pytest.raises(ValueError, match=culprit):
        LidarEnv(Explore, sensors=sensors, **QUICK)
