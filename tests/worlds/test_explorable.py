import math

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import World, explorable_area, rasterize


def squares(*sides, angle=0.0, spawn):
    """Walls along squares around the origin, turned by `angle`; `spawn` is the position along the x axis."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2.0
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    walls = [np.hstack([side * corners, side * np.roll(corners, 1, axis=0)]) for side in sides]
    return World(
        name="squares",
        segments=(np.concatenate(walls).reshape(-1, 2) @ turn).reshape(-1, 4),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(*(np.array([spawn, 0.0]) @ turn), 0.0),),
        bounds=(-max(sides), -max(sides), max(sides), max(sides)),
    )


def ring(width, length, angle=0.0):
    """Square ring of corridors; `length` is measured along its middle."""
    return squares(length / 4 + width, length / 4 - width, angle=angle, spawn=length / 8)


@pytest.mark.parametrize("width", [0.5, 0.9])
@pytest.mark.parametrize("angle", [0.0, 0.2, math.pi / 8, 0.6, math.pi / 4])
def test_corridors_are_as_long_however_they_are_turned(width, angle):
    area = explorable_area(ring(width, 24.0, angle), load_robot("turtlebot3_burger"), 0.05)
    assert area.corridor_length == pytest.approx(24.0, rel=0.07)


def test_a_task_with_a_goal_on_a_given_map_does_not_ask_what_can_be_seen(monkeypatch):
    world, asked = squares(6.0, spawn=1.0), []

    def visible_from(free, goals, *_):
        asked.append(1)
        return goals

    monkeypatch.setattr("lidarnaut.envs.worlds.explorable.visible_from", visible_from)
    grid = rasterize(world, 0.05)
    options = {"world": world, "physics": "kinematic", "localizer": "odometry"}
    LidarEnv(Navigate, map=grid, map_pose=(*grid.origin, 0.0), **options).reset(seed=0)
    assert not asked
    env = LidarEnv(Navigate, **options)
    env.reset(seed=0)
    assert len(asked) == 1
    env.prepare()
    assert LidarEnv(Navigate, **options).reset(seed=0)
    assert len(asked) == 1


def test_rooms_have_time_by_their_area_and_rings_of_narrow_corridors_by_their_length():
    burger = load_robot("turtlebot3_burger")
    room, narrow = (explorable_area(world, burger, 0.05) for world in (squares(10.0, spawn=1.0), ring(0.5, 60.0)))
    assert room.usual_time_limit(0.22) == 120.0 + 10.0 * round(0.2 * room.area / 0.22)
    assert narrow.usual_time_limit(0.22) == pytest.approx(60.0 + 60.0 / (0.4 * 0.22), rel=0.07)
    assert narrow.usual_time_limit(0.44) < narrow.usual_time_limit(0.22)
