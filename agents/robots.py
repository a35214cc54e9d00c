"""Robots that policies for goals are trained with: the Jackal, with other lidars, limits and sizes.

Of the library's robots none but the Jackal is seen in training.
"""

from dataclasses import replace
from typing import Any

from envs.robots import RobotParams, load_robot

JACKAL = load_robot("jackal")


def _variant(name: str, fov: float, range_max: float = 30.0, **limits: Any) -> RobotParams:
    """Return a Jackal with a lidar of 360 beams over an angle [rad], and other limits or another radius."""
    lidar = replace(JACKAL.lidar, num_beams=360, fov=fov, range_max=range_max)
    return replace(JACKAL, name=name, lidar=lidar, **limits)


SEES_AHEAD = _variant("sees_ahead", 4.71)
"""270 degrees, as the Jackal itself, with half its beams."""
SEES_AROUND = _variant("sees_around", 6.28)
SLOW_SEES_AROUND = _variant("slow_sees_around", 6.28, max_v=1.0, max_w=3.0)
SMALL = _variant("small", 4.71, range_max=12.0, radius=0.25, max_v=1.5, max_acc_v=3.0)
"""Smaller and more sluggish, with a lidar of 12 m."""
