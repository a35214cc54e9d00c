"""Simultaneous localization and mapping, and mapping with known poses."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

from envs.estimation import Belief, Estimator
from envs.files import resolve
from envs.robots import LidarParams

from .known_poses import KnownPoses
from .observers import MatcherObserver
from .params import PRESET_NAMES, TinySlamParams, load_params
from .tinyslam import TinySlam

SLAMS: dict[str, Callable[[LidarParams, TinySlamParams], Estimator]] = {
    "tinyslam": TinySlam,
    "odometry": KnownPoses,
    "truth": KnownPoses,
}
"""By name. "odometry" and "truth" map at the poses that follow from odometry and from ground truth."""
SLAM_NAMES = tuple(SLAMS)


def make_slam(
    name: Any, lidar: LidarParams, resolution: float = 0.05, preset: str | TinySlamParams = "default"
) -> Estimator:
    """Build a SLAM.

    Args:
        name: one of `SLAM_NAMES`; `module:attribute`, or a callable, of the user's own that is called with the lidar
            (`LidarParams`) and the resolution [m] and returns an `Estimator`; or an `Estimator`, which is copied.
        lidar: geometry of the scans.
        resolution: side of a map cell [m].
        preset: name or YAML file of the parameters, or the parameters; `resolution` replaces theirs.

    Raises:
        ValueError: if the name, the preset or the resolution is not allowed.
    """
    if isinstance(name, str) and name in SLAMS:
        return SLAMS[name](lidar, dataclasses.replace(load_params(preset), resolution=resolution))
    found: Any = resolve(name, dict[str, Any](SLAMS), "SLAM")
    if callable(found):
        return found(lidar, resolution)
    if not hasattr(found, "update"):
        raise ValueError(f"slam must be a name, module:attribute, a callable or an Estimator, got {name!r}")
    return copy.deepcopy(found)


__all__ = [
    "PRESET_NAMES",
    "SLAM_NAMES",
    "Belief",
    "Estimator",
    "KnownPoses",
    "MatcherObserver",
    "TinySlam",
    "TinySlamParams",
    "load_params",
    "make_slam",
]
