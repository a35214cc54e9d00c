"""Robots that policies for goals are trained with: the Jackal, with other lidars and limits.

Of the library's robots none but the Jackal is seen in training.
"""

from dataclasses import replace
from typing import Any

from lidarnaut.envs.robots import RobotParams, load_robot

JACKAL = load_robot("jackal")


def _variant(name: str, fov: float, **limits: Any) -> RobotParams:
    """Return a Jackal with a lidar of 360 beams over an angle [rad], and other limits."""
    lidar = replace(JACKAL.lidar, num_beams=360, fov=fov)
    return replace(JACKAL, name=name, lidar=lidar, **limits)


SEES_AHEAD = _variant("sees_ahead", 4.71)
"""270 degrees, as the Jackal itself, with half its beams."""
SEES_AROUND = _variant("sees_around", 6.28)
SLOW_SEES_AROUND = _variant("slow_sees_around", 6.28, max_v=1.0, max_w=3.0)
