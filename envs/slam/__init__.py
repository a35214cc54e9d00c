"""Simultaneous localization and mapping, and mapping with known poses."""

import copy
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from lidarnaut.envs.estimation import Belief, Estimator
from lidarnaut.envs.files import resolve
from lidarnaut.envs.robots import LidarParams, OdometryNoise

from .gmapping.gmapping import GMapping
from .graph.graph_slam import GraphSlam
from .hector import Hector
from .matcher import MatcherObserver
from .params import (
    PRESETS,
    GMappingParams,
    GraphSlamParams,
    HectorParams,
    LoopClosureParams,
    Params,
    TinySlamParams,
    load_params,
)
from .posegraph import PoseGraphView
from .tinyslam import KnownPoses, TinySlam


class Kind(NamedTuple):
    """How a SLAM is built."""

    make: Callable[[LidarParams, Any], Estimator]
    """Returns the SLAM for a lidar and its params."""
    load: Callable[..., Any]
    """Returns params by the name of a preset or what else stands for them, with changes; see `load_params`."""


SLAMS: dict[str, Kind] = {
    "tinyslam": Kind(TinySlam, load_params),
    "hector": Kind(Hector, partial(load_params, slam="hector")),
    "graph": Kind(GraphSlam, partial(load_params, slam="graph")),
    "gmapping": Kind(GMapping, partial(load_params, slam="gmapping")),
    "odometry": Kind(KnownPoses, load_params),
    "truth": Kind(KnownPoses, load_params),
}
"""By name. "odometry" and "truth" map at the poses that follow from odometry and from ground truth."""
SLAM_NAMES = tuple(SLAMS)
DEFAULT_SLAM = "hector"
"""What environments use: fast, deterministic, and robots of a team share its map; see docs/notes/slam_comparison.md."""


def make_slam(
    name: Any,
    lidar: LidarParams,
    resolution: float = 0.05,
    preset: str | Path | Params = "default",
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
        kind: Kind = SLAMS[name]
        changes: dict[str, Any] = {"resolution": resolution}
        if odometry_noise is not None:
            changes["odometry_noise"] = odometry_noise
        return kind.make(lidar, kind.load(kind.load(preset), changes))
    found: Any = resolve(name, dict[str, Any](SLAMS), "SLAM")
    if callable(found):
        return found(lidar, resolution)
    if not hasattr(found, "update"):
        raise ValueError(f"slam must be a name, module:attribute, a callable or an Estimator, got {name!r}")
    return copy.deepcopy(found)


__all__ = [
    "DEFAULT_SLAM",
    "PRESETS",
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
    "LoopClosureParams",
    "MatcherObserver",
    "PoseGraphView",
    "TinySlam",
    "TinySlamParams",
    "load_params",
    "make_slam",
]
