"""SLAM algorithms, and mapping at known poses."""

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
from .posegraph import PoseGraphView
from .slam_params import (
    PRESETS,
    GMappingParams,
    GraphSlamParams,
    HectorParams,
    LoopClosureParams,
    Params,
    TinySlamParams,
    load_params,
)
from .tinyslam import KnownPoses, TinySlam


class Kind(NamedTuple):
    """SLAM algorithm: constructor and function that loads parameters."""

    make: Callable[[LidarParams, Any], Estimator]
    load: Callable[..., Any]


SLAMS: dict[str, Kind] = {
    "tinyslam": Kind(TinySlam, load_params),
    "hector": Kind(Hector, partial(load_params, slam="hector")),
    "graph": Kind(GraphSlam, partial(load_params, slam="graph")),
    "gmapping": Kind(GMapping, partial(load_params, slam="gmapping")),
    "odometry": Kind(KnownPoses, load_params),
    "truth": Kind(KnownPoses, load_params),
}
"""SLAM algorithms by name. "odometry" and "truth" only build a map, at odometry or ground-truth poses."""
SLAM_NAMES = tuple(SLAMS)
DEFAULT_SLAM = "hector"
"""Default SLAM algorithm: fast, deterministic, and able to share a map between robots."""


def make_slam(
    name: Any,
    lidar: LidarParams,
    resolution: float = 0.05,
    preset: str | Path | Params = "default",
    odometry_noise: OdometryNoise | None = None,
) -> Estimator:
    """Create a SLAM algorithm, which updates a pose and a map from lidar scans and odometry.

    Args:
        name: one of `SLAM_NAMES`; an `Estimator` object, which is copied; or a callable, or import path
            `module:attribute`, that returns an `Estimator` from `lidar` and `resolution`.
        lidar: beam geometry.
        resolution: side of a map cell [m]; overrides the preset.
        preset: preset name, YAML file, or parameter object.
        odometry_noise: overrides the preset; None keeps it.

    Raises:
        ValueError: if the name, the preset or the resolution is invalid.
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
