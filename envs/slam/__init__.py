"""Simultaneous localization and mapping, and mapping with known poses."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

from envs.estimation import Belief, Estimator
from envs.files import resolve
from envs.robots import LidarParams, OdometryNoise

from .gmapping import GMAPPING_PRESETS, GMapping, GMappingParams, load_gmapping_params
from .graph.graph_slam import GraphSlam
from .graph.params import GRAPH_PRESETS, GraphSlamParams, load_graph_params
from .graph.pose_graph_view import PoseGraphView
from .hector import Hector
from .hector_params import HECTOR_PRESETS, HectorParams, load_hector_params
from .known_poses import KnownPoses
from .observers import MatcherObserver
from .params import PRESET_NAMES, TinySlamParams, load_params
from .tinyslam import TinySlam


class Kind(NamedTuple):
    """How a SLAM is built."""

    make: Callable[[LidarParams, Any], Estimator]
    """Returns the SLAM for a lidar and its params."""
    load: Callable[..., Any]
    """Returns params by the name of a preset or what else stands for them, with changes; see `load_params`."""


SLAMS: dict[str, Kind] = {
    "tinyslam": Kind(TinySlam, load_params),
    "hector": Kind(Hector, load_hector_params),
    "graph": Kind(GraphSlam, load_graph_params),
    "gmapping": Kind(GMapping, load_gmapping_params),
    "odometry": Kind(KnownPoses, load_params),
    "truth": Kind(KnownPoses, load_params),
}
"""By name. "odometry" and "truth" map at the poses that follow from odometry and from ground truth."""
SLAM_NAMES = tuple(SLAMS)
DEFAULT_SLAM = "hector"
"""What environments use: fast, deterministic, and robots of a team can share its map; docs/slam.md compares."""


def make_slam(
    name: Any,
    lidar: LidarParams,
    resolution: float = 0.05,
    preset: str | TinySlamParams | HectorParams | GraphSlamParams | GMappingParams = "default",
    odometry_noise: OdometryNoise | None = None,
) -> Estimator:
    """Build a SLAM.

    Args:
        name: one of `SLAM_NAMES`; `module:attribute`, or a callable, of the user's own that is called with the lidar
            (`LidarParams`) and the resolution [m] and returns an `Estimator`; or an `Estimator`, which is copied.
        lidar: geometry of the scans.
        resolution: side of a map cell [m].
        preset: name or YAML file of the parameters, or the parameters; `resolution` replaces theirs. Each SLAM has
            presets of its own.
        odometry_noise: how far the robot's odometry may be off, in place of what the preset says; None keeps that.

    Raises:
        ValueError: if the name, the preset or the resolution is not allowed.
    """
    if isinstance(name, str) and name in SLAMS:
        kind = SLAMS[name]
        params = dataclasses.replace(kind.load(preset), resolution=resolution)
        if odometry_noise is not None:
            params = dataclasses.replace(params, odometry_noise=odometry_noise)
        return kind.make(lidar, params)
    found: Any = resolve(name, dict[str, Any](SLAMS), "SLAM")
    if callable(found):
        return found(lidar, resolution)
    if not hasattr(found, "update"):
        raise ValueError(f"slam must be a name, module:attribute, a callable or an Estimator, got {name!r}")
    return copy.deepcopy(found)


__all__ = [
    "DEFAULT_SLAM",
    "GMAPPING_PRESETS",
    "GRAPH_PRESETS",
    "HECTOR_PRESETS",
    "PRESET_NAMES",
    "SLAMS",
    "SLAM_NAMES",
    "Belief",
    "Estimator",
    "GMapping",
    "GMappingParams",
    "GraphSlam",
    "GraphSlamParams",
    "Hector",
    "HectorParams",
    "KnownPoses",
    "MatcherObserver",
    "PoseGraphView",
    "TinySlam",
    "TinySlamParams",
    "load_gmapping_params",
    "load_graph_params",
    "load_hector_params",
    "load_params",
    "make_slam",
]
