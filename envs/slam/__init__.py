"""SLAM algorithms, and mapping at known poses."""

import copy
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from lidarnaut.envs.estimation import Belief, Estimator
from lidarnaut.envs.files import resolve, split_parameters, with_defaults
from lidarnaut.envs.robots import LidarParams, OdometryNoise

from .gmapping.gmapping import GMapping
from .graph.graph_slam import GraphSlam
from .hector import Hector
from .matcher import MatcherObserver, MatcherTrace
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

SLAMS: dict[str, Callable[[LidarParams, Any], Estimator]] = {
    "tinyslam": TinySlam,
    "hector": Hector,
    "graph": GraphSlam,
    "gmapping": GMapping,
    "odometry": KnownPoses,
    "truth": KnownPoses,
}
"""SLAM algorithms by name. "odometry" and "truth" only build a map, at odometry or ground-truth poses."""
SLAM_NAMES = tuple(SLAMS)
DEFAULT_SLAM = "hector"
"""Default SLAM algorithm: fast, deterministic, and able to share a map between robots."""


def read_params(name: str, preset: str | Path | Params = "default", changes: Mapping[str, Any] | None = None) -> Params:
    """Return the parameters of a SLAM algorithm given as `NAME?preset=PRESET,KEY=VALUE`.

    Args:
        name: one of `SLAM_NAMES`, optionally with parameters, for example `hector?preset=faithful,num_levels=3`.
            These take precedence over the other arguments.
        preset: preset name, YAML file, or parameter object.
        changes: new values by parameter name.

    Raises:
        ValueError: the name, the preset, a key or a value is invalid.
    """
    base, own = split_parameters(name)
    preset, load = own.pop("preset", preset), partial(load_params, slam=base if base in PRESETS else "tinyslam")
    try:
        params: Params = load(preset, changes)
        return load(params, own) if own else params
    except ValueError as error:
        raise ValueError(f"slam {name!r}: {error}" if "?" in name else error) from error


def make_slam(
    name: Any,
    lidar: LidarParams,
    resolution: float = 0.05,
    preset: str | Path | Params = "default",
    odometry_noise: OdometryNoise | None = None,
) -> Estimator:
    """Create a SLAM algorithm, which updates a pose and a map from lidar scans and odometry.

    Args:
        name: one of `SLAM_NAMES`, optionally with parameters as in `tinyslam?preset=robot_vacuum,sigma_xy=0.02`; an
            `Estimator` object, which is copied; or a callable, or import path `module:attribute`, that returns an
            `Estimator` from `lidar` and `resolution`.
        lidar: beam geometry.
        resolution: side of a map cell [m]; overrides the preset.
        preset: preset name, YAML file, or parameter object.
        odometry_noise: overrides the preset; None keeps it.

    Raises:
        ValueError: if the name, the preset, a parameter or the resolution is invalid.
    """
    base, own = split_parameters(name) if isinstance(name, str) else (name, {})
    found: Any = resolve(base, dict[str, Any](SLAMS), "SLAM")
    if base_name(name) is not None:
        for key in own.keys() & {"resolution", "odometry_noise"}:
            source = "map_resolution" if key == "resolution" else "the robot"
            raise ValueError(f"slam {name!r}: {key} is not a parameter here, it is set by {source}")
        changes = {"resolution": resolution} | ({} if odometry_noise is None else {"odometry_noise": odometry_noise})
        params = read_params(name, preset, changes)
        try:
            return found(lidar, params)
        except ValueError as error:
            raise ValueError(f"slam {name!r}: {error}") from error
    if own:
        raise ValueError(f"slam {name!r}: only SLAMs of this package take parameters: {', '.join(SLAMS)}")
    made = found(lidar, resolution) if callable(found) else copy.deepcopy(found)
    if not hasattr(made, "update"):
        raise ValueError(f"slam must be a name, module:attribute, a callable or an Estimator, got {name!r}")
    estimator: Estimator = with_defaults(made, Estimator)
    return estimator


def base_name(name: Any) -> str | None:
    """Return the algorithm's name from `NAME?KEY=VALUE`; None if `name` is no SLAM of this package."""
    base = name.partition("?")[0] if isinstance(name, str) else None
    return base if base in SLAMS else None


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
    "MatcherTrace",
    "PoseGraphView",
    "TinySlam",
    "TinySlamParams",
    "base_name",
    "load_params",
    "make_slam",
    "read_params",
]
