"""Parameters of TinySLAM, and the presets that come with it."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict

from envs.robots import OdometryNoise

from .preset_files import find_presets, load_preset

PRESETS = find_presets()
"""Files of the presets by name."""
PRESET_NAMES = tuple(PRESETS)
"""Presets that `load_params` accepts by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TinySlamParams:
    """All params of TinySLAM.

    Defaults are those of the original's program code (OSLL/tiny-slam-ros-cpp); `docs/slam.md` compares them with the
    original's launch file, with Nguyen et al. (TinySLAM for a robot vacuum, 2025), and with what the environments use.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    sigma_xy: float = 0.2
    """Spread of candidates around the best pose so far, per axis, at the start of a scan [m]."""
    sigma_theta: float = 0.1
    """Spread of candidates' headings around the best so far, at the start of a scan [rad]."""
    max_failed: int = 20
    """Candidates that may fail to improve before the search ends."""
    max_tries: int = 100
    """Candidates that may be tried for one scan."""
    cell: Literal["avg", "base", "report"] = "avg"
    """How cells take in observations: as their mean (`avg`), by exponential forgetting (`base`), or by the formula in
    the text of Nguyen et al., 2025 (`report`)."""
    estimator: Literal["const", "area"] = "const"
    """What a beam says of a cell: always the same (`const`), or what follows from where it cuts the cell (`area`)."""
    occupied_prob: float = 0.95
    """Occupancy that a beam reports of the cell it ends in."""
    empty_prob: float = 0.01
    """Occupancy that a beam reports of the cells it passes."""
    quality: float = 0.9
    """Weight of a scan whose pose the matcher has corrected, from 0 to 1; not used by `report` cells."""
    raw_quality: float = 0.6
    """Weight of a scan mapped at the predicted pose, from 0 to 1; not used by `report` cells."""
    unvisited: float = -1.0
    """Occupancy that the matcher assumes of cells never observed, from -1 to 1."""
    hole_width: float = 1.5
    """Depth of the ramp in front of a hit over which occupancy rises [m]. 0 for none."""
    blur: Literal["add", "assign"] = "add"
    """Whether the ramp is added to the occupancy of a passed cell (the original) or replaces it (its successor)."""
    skip_exceeding: bool = False
    """Whether beams without a return are left out of the map; else they clear it up to the lidar's range."""
    min_travel_distance: float = 0.0
    """A scan is integrated once the robot is this far from where the last one was [m]; 0 for every scan. Integrated
    more often, a scan is matched to the noise of the one before rather than to the environment."""
    min_travel_angle: float = 0.0
    """... or once it has turned by this much since [rad]."""
    prior_weight: float = 0.0
    """What a squared standard deviation from the predicted pose adds to the cost of a candidate, which is the number of
    hits less the sum of their cells' occupancies; 0 for a search that odometry does not hold (the original)."""
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Standard deviations of odometry's motion from one matched scan to the next."""
    match_every_scan: bool = True
    """Whether every scan is matched; else only those that are integrated are, and between them the pose follows
    odometry."""
    odometry: Literal["robot_frame", "odometry_frame"] = "robot_frame"
    """Whether motion is applied along the estimated heading, or added as odometry's own frame sees it, as the originals
    do, which is wrong as soon as the two frames are turned against each other."""
    map_width: float = 20.0
    """Extent of a new map along x [m]; it grows when needed."""
    map_height: float = 20.0
    """Extent of a new map along y [m]; it grows when needed."""
    resolution: float = 0.1
    """Side of a cell [m]."""

    def __post_init__(self) -> None:
        for name in ("sigma_xy", "sigma_theta", "hole_width", "prior_weight"):
            self._require(0 <= getattr(self, name) < math.inf, name, "must not be negative")
        for name in ("min_travel_distance", "min_travel_angle"):
            self._require(0 <= getattr(self, name) < math.inf, name, "must not be negative")
        for name in ("map_width", "map_height", "resolution"):
            self._require(0 < getattr(self, name) < math.inf, name, "must be positive")
        for name in ("occupied_prob", "empty_prob", "quality", "raw_quality"):
            self._require(0 <= getattr(self, name) <= 1, name, "must lie in [0, 1]")
        self._require(-1 <= self.unvisited <= 1, "unvisited", "must lie in [-1, 1]")
        for name in ("max_failed", "max_tries"):
            self._require(getattr(self, name) >= 1, name, "must be at least 1")

    def _require(self, condition: bool, name: str, what: str) -> None:
        if not condition:
            raise ValueError(f"{name} {what}, got {getattr(self, name)!r}")


def load_params(preset: str | Path | TinySlamParams, changes: Mapping[str, Any] | None = None) -> TinySlamParams:
    """Return params by the name of a preset, by the path of a YAML file, by `module:attribute`, or as they are.

    `changes` are values to replace; text that reads as a number is taken for it.

    Raises:
        ValueError: the name is unknown, or the file has an unknown key or a value that makes no sense; the message
            names file and key.
        FileNotFoundError: there is no file at the path.
    """
    if preset == "seed1":
        warnings.warn("TinySLAM's preset 'seed1' is now called 'robot_vacuum'", DeprecationWarning, stacklevel=2)
        preset = "robot_vacuum"
    return load_preset(TinySlamParams, preset, PRESETS, "preset", changes, _renamed)


def _renamed(values: dict[str, Any]) -> dict[str, Any]:
    """Return values with the keys of today for those of before."""
    for old, new in (("draw_distance", "min_travel_distance"), ("draw_angle", "min_travel_angle")):
        if old in values:
            warnings.warn(f"TinySLAM's {old!r} is now called {new!r}", DeprecationWarning, stacklevel=4)
            values[new] = values.pop(old)
    return values
