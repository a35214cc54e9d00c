"""Briefs: what a driver uses of the tasks of environments."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest

from lidarnaut import make_explorer, register
from lidarnaut.driver import Driver
from lidarnaut.envs.navigation import GoalNavigator
from lidarnaut.envs.observations.positions import GOAL_MEMORY
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import KnownPoses
from lidarnaut.envs.task import BoxPart, Task
from lidarnaut.envs.tasks.goals import known_map
from lidarnaut.envs.tasks.starts import UnknownWorldBrief, UnknownWorldTask
from lidarnaut.envs.worlds import explorable_area, load_world

from .feeding import NUM_BEAMS, feed

BURGER = "turtlebot3_burger"


class Near(BoxPart):
    size = 1

    def write(self, robot, out):
        out[0] = float(robot.ranges.min() < 1.0)


@dataclass(kw_only=True, eq=False)
class OwnBrief(UnknownWorldBrief):
    slam: Any = "odometry"

    def observation_parts(self):
        return {"near": Near}


@dataclass(kw_only=True, eq=False)
class Own(OwnBrief, UnknownWorldTask):
    weights = {"time": -1.0}


@dataclass(kw_only=True, eq=False)
class OwnParts(UnknownWorldTask):
    weights = {"time": -1.0}
    slam: Any = "odometry"
    observation_parts = OwnBrief.observation_parts


@pytest.fixture
def own_ids():
    ids = {kind: f"tests/{kind.__name__}-v0" for kind in (Own, OwnParts)}
    for kind, id in ids.items():
        register(id, kind)
    yield ids
    for id in ids.values():
        gymnasium.registry.pop(id)


def begun(driver):
    feed(driver, 0.0, ranges=np.full(NUM_BEAMS, 0.9))
    return driver


def test_a_driver_uses_the_brief_of_an_own_task(own_ids):
    driver = begun(Driver(make_explorer("nearest"), BURGER, id=own_ids[Own]))
    assert type(driver.env.task) is OwnBrief
    assert isinstance(driver.env.robots[0].estimator, KnownPoses)
    assert driver.env.observe()["near"] == 1.0
    with pytest.raises(ValueError, match=r"defines \['observation_parts', 'slam'\]: define them in a sub"):
        Driver(make_explorer("nearest"), BURGER, id=own_ids[OwnParts])


@pytest.mark.parametrize("name", ["Explore", "ReachGoal", "Navigate", "Sweep", "Dock"])
def test_a_driver_has_no_world_reward_or_end(name):
    map = known_map(explorable_area(load_world("turtlebot3_house"), load_robot(BURGER), 0.1))
    known = {"map": map} if name in ("Navigate", "Sweep", "Dock") else {"slam": "odometry"}
    driver = begun(Driver(GoalNavigator(), BURGER, id=f"lidarnaut/{name}-v0", **known))
    env = driver.env
    assert not isinstance(env.task, Task)
    assert (env.world.name, env.task.rewards.weights, env.is_over) == ("unknown", {}, (False, False))
    assert env.scene().progress == 0.0
    for argument in ("split", "num_worlds", "contact", "target_coverage", "map_pose"):
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{argument}'"):
            Driver(make_explorer("nearest"), BURGER, id=f"lidarnaut/{name}-v0", **known, **{argument: "test"})


def test_a_goal_may_be_an_argument():
    driver = begun(Driver(GoalNavigator(), BURGER, id="lidarnaut/ReachGoal-v0", goal=(1.5, 0.5)))
    assert driver.env.task.goal == (1.5, 0.5, 0.0)
    assert driver.reason == ""
    np.testing.assert_array_equal(driver.env.rows.memory[GOAL_MEMORY], [[1.5, 0.5]])
