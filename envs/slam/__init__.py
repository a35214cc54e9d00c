"""Simultaneous localisation and mapping."""

import dataclasses
from typing import Any

from envs.files import resolve
from envs.robots import LidarParams

from .given_pose import GivenPoseSlam
from .observers import MatcherObserver
from .params import PRESET_NAMES, TinySlamParams, load_params
from .slam import Belief, Slam
from .tinyslam import TinySlam

_CLASSES: dict[str, type[TinySlam] | type[GivenPoseSlam]] = {
    "tinyslam": TinySlam,
    "odometry": GivenPoseSlam,
    "truth": GivenPoseSlam,
}
SLAM_NAMES = tuple(_CLASSES)
"""What `make_slam` can make. "odometry" and "truth" map at the pose that the motions lead to."""


def make_slam(
    name: str, lidar: LidarParams, resolution: float = 0.05, preset: str | TinySlamParams = "default"
) -> Slam:
    """Build a SLAM.

    Args:
        name: one of `SLAM_NAMES`, or `module:attribute` of the user's own, which is called with the lidar
            (`LidarParams`) and the resolution [m].
        lidar: geometry of the scans.
        resolution: side of a map cell [m].
        preset: name or YAML file of the params, or the params; `resolution` replaces theirs.

    Raises:
        ValueError: if the name, the preset or the resolution makes no sense.
    """
    if name not in _CLASSES:
        return resolve(name, dict[str, Any](_CLASSES), "SLAM")(lidar, resolution)
    return _CLASSES[name](lidar, dataclasses.replace(load_params(preset), resolution=resolution))


__all__ = [
    "PRESET_NAMES",
    "SLAM_NAMES",
    "Belief",
    "GivenPoseSlam",
    "MatcherObserver",
    "Slam",
    "TinySlam",
    "TinySlamParams",
    "load_params",
    "make_slam",
]
