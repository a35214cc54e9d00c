"""Training robots of goal-reaching policies: variants of the Clearpath Jackal."""

from dataclasses import replace
from typing import Any

from lidarnaut.envs.robots import RobotParams, load_robot

JACKAL = load_robot("jackal")


def _variant(name: str, fov: float, range_max: float = JACKAL.lidar.range_max, **limits: Any) -> RobotParams:
    lidar = replace(JACKAL.lidar, num_beams=360, fov=fov, range_max=range_max)
    return replace(JACKAL, name=name, lidar=lidar, **limits)


SEES_AHEAD = _variant("sees_ahead", 4.71)
"""Jackal with half its lidar beams (360), over 270 degrees."""
SEES_AROUND = _variant("sees_around", 6.28)
SLOW_SEES_AROUND = _variant("slow_sees_around", 6.28, max_v=1.0, max_w=3.0)
_SMALL: Any = {"radius": 0.2, "body": replace(JACKAL.body, radius=0.2), "max_acc_v": 1.0, "max_acc_w": 3.2}
SMALL_SEES_AROUND = _variant("small_sees_around", 6.28, 3.5, max_v=0.3, max_w=1.8, **_SMALL)
"""Robot with 360 degree lidar, and about the size, speed and lidar range of a TurtleBot3."""
