"""Parameters of GMapping, and the presets that come with it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ConfigDict

from envs.robots import OdometryNoise

from ..preset_files import find_presets, load_preset

GMAPPING_PRESETS = find_presets("gmapping")
"""Files of the presets by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GMappingParams:
    """All params of `GMapping`. The defaults are those of the environments."""

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    match_every_scan: ClassVar[bool] = False
    """Key scans alone are matched; see `KeyScanSlam`."""
    num_particles: int = 20
    """Number of particles, each with a map of its own."""
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Standard deviations of odometry's motion from one key scan to the next: the motion model."""
    residual_variance: float = 0.5
    """Variance of a hit's residual, 1 minus the occupancy where it falls: weighs the scan against the motion model in
    the proposal distribution, and particles against each other. The hits of a scan err together, and so this exceeds
    what a single one shows."""
    likelihood_gain: float = 0.2
    """Exponent of the likelihood in the importance weights, above 0 and not above 1: successive scans err together as
    well, and without it few particles would take all weight."""
    resample_below: float = 0.5
    """Effective sample size, as a fraction of the particles, below which they are resampled."""
    switch_margin: float = 2.0
    """Another particle becomes the best one if the log likelihood of all scans along its trajectory, times
    `likelihood_gain`, exceeds that of the best one by more than this."""
    num_levels: int = 2
    """Maps that the matcher works on, from the coarsest to the finest; each has cells twice as wide as the next."""
    iterations: int = 6
    """Greatest number of Gauss-Newton steps on the finest map."""
    coarse_iterations: int = 4
    """Greatest number of Gauss-Newton steps on each of the others."""
    search_distance: float | None = None
    """Motion since the last key scan from which on a correlative search precedes Gauss-Newton [m]; None for never."""
    search_angle: float | None = None
    """... or turn since then [rad]; None for never."""
    retry_below: float = 0.4
    """Mean occupancy of the known cells under the hits, from 0 to 1. If particles with half of the weight or more stay
    below, a second correlative search looks farther around; 0 for never."""
    retry_distance: float = 0.8
    """Half width of the second search, and the farthest that any match may be off the pose by odometry [m]."""
    retry_angle: float = 0.35
    """Half width of the second search in heading [rad]."""
    retry_gain: float = 0.05
    """What the second search must add to the occupancies of the known cells under the hits, for each hit."""
    min_known_score: float = 0.25
    """A scan whose hits on known cells fall on less occupied ones in the mean, from 0 to 1, does not match the map of a
    particle: it is not integrated into it, and the particle's pose is drawn from the motion model."""
    min_known_hits: int = 20
    """Hits on known cells without which a scan is not judged."""
    lost_scans: int = 3
    """Key scans in succession that do not fit the map of the best particle, from which on the robot is lost."""
    max_position_std: float = 1.0
    """Standard deviation of the particles' positions along its worst direction from which on the robot is lost [m]."""
    occupied_prob: float = 0.9
    """Occupancy that a beam reports of the cell it ends in, above one half."""
    empty_prob: float = 0.4
    """Occupancy that a beam reports of the cells it passes, below one half."""
    max_log_odds: float = 50.0
    """Largest log odds of a cell, and with the opposite sign the least; at most 63."""
    skip_exceeding: bool = False
    """Whether beams without a return are left out of the map; else they clear it up to the lidar's range."""
    min_travel_distance: float = 0.3
    """A scan is a key scan once the robot is this far from where the last one was [m]."""
    min_travel_angle: float = 0.3
    """... or once it has turned by this much since [rad]."""
    map_width: float = 20.0
    """Extent of a new map along x [m]; it grows when needed."""
    map_height: float = 20.0
    """Extent of a new map along y [m]; it grows when needed."""
    resolution: float = 0.05
    """Side of a cell of the finest map [m]."""

    def __post_init__(self) -> None:
        def require(condition: bool, name: str, what: str) -> None:
            if not condition:
                raise ValueError(f"{name} {what}, got {getattr(self, name)!r}")

        for name in ("search_distance", "search_angle"):
            require((getattr(self, name) or 0.0) >= 0, name, "must not be negative")
        for name in ("min_travel_distance", "min_travel_angle", "retry_gain"):
            require(0 <= getattr(self, name) < math.inf, name, "must not be negative")
        require(0 <= self.switch_margin < math.inf, "switch_margin", "must not be negative")
        for name in ("map_width", "map_height", "resolution", "residual_variance", "max_position_std"):
            require(0 < getattr(self, name) < math.inf, name, "must be positive")
        for name in ("retry_distance", "retry_angle"):
            require(0 < getattr(self, name) < math.inf, name, "must be positive")
        for name in ("num_particles", "num_levels", "iterations", "coarse_iterations", "lost_scans", "min_known_hits"):
            require(getattr(self, name) >= 1, name, "must be at least 1")
        require(self.num_levels <= 4, "num_levels", "must be at most 4")
        for name in ("retry_below", "min_known_score", "resample_below"):
            require(0 <= getattr(self, name) <= 1, name, "must lie in [0, 1]")
        require(0 < self.likelihood_gain <= 1, "likelihood_gain", "must lie above 0 and not above 1")
        require(0.5 < self.occupied_prob < 1, "occupied_prob", "must lie above 0.5 and below 1")
        require(0 < self.empty_prob < 0.5, "empty_prob", "must lie above 0 and below 0.5")
        require(0 < self.max_log_odds <= 63, "max_log_odds", "must lie above 0 and not above 63")


def load_gmapping_params(
    preset: str | Path | GMappingParams, changes: Mapping[str, Any] | None = None
) -> GMappingParams:
    """Return params by the name of a preset or what else stands for them; see `load_preset`."""
    return load_preset(GMappingParams, preset, GMAPPING_PRESETS, "preset of gmapping", changes)
