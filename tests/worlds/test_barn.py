import math

import numpy as np
import pytest

from lidarnaut.envs.arguments import choose_robot
from lidarnaut.envs.tasks.goals import GeodesicDistance
from lidarnaut.envs.worlds import BARN_NAMES, check_world, explorable_area, load_world, world_sampler


def test_the_worlds_are_as_published():
    assert len(BARN_NAMES) == 300
    counts = [len(load_world(name).circles) for name in BARN_NAMES]
    assert (sum(counts), min(counts), max(counts)) == (78_925, 181, 365)
    world = load_world("barn:0")
    assert world.optimal_length == pytest.approx(2.0 * 6.796149)
    assert world.circles[0].tolist() == [-0.075, 0.075, 0.075]
    assert (tuple(world.spawns[0]), tuple(world.goals[0])) == ((-2.25, 3.0, math.pi / 2), (-2.25, 13.0, math.pi / 2))
    assert world.licence == "MIT"
    assert "Perille" in world.source
    assert world_sampler("barn:0")(np.random.default_rng(0)) is load_world("barn:0") is world


def test_their_robot_reaches_the_goal_of_each_by_about_the_published_path():
    robot = choose_robot(None, "barn:7")
    assert robot.name == choose_robot(None, load_world("barn:7")).name == "jackal"
    for name in BARN_NAMES[::6]:
        world = check_world(load_world(name))
        area = explorable_area(world, robot, 0.05)
        length = GeodesicDistance(area, world.goals[0]).length(world.spawns[0])
        # Published paths go by cells of 0.15 m from centre to centre, through narrower gaps.
        assert 0.75 < length / world.optimal_length < 1.1, name
