"""Parameters and presets of all SLAM algorithms."""

from collections.abc import Mapping
from dataclasses import asdict, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import parse_record, read_mapping, resolve
from lidarnaut.envs.robots import OdometryNoise

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class SlamParams:
    """Common parameters of all SLAMs."""

    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Odometry standard deviations between two matched scans."""
    min_travel_distance: NotNegative = 0.2
    """Minimum distance between integrated scans [m]; 0 for every scan. At short distances, scans match each other's
    noise."""
    min_travel_angle: NotNegative = 0.6
    """Minimum turn between integrated scans, as alternative to the distance [rad]."""
    skip_exceeding: bool = False
    """Ignore beams without a return in mapping instead of clearing cells up to the maximum range."""
    map_width: Positive = 20.0
    """Initial map size along x [m]; grows when needed."""
    map_height: Positive = 20.0
    """Initial map size along y [m]; grows when needed."""
    resolution: Positive = 0.05
    """Side of a finest-level map cell [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class TinySlamParams(SlamParams):
    """Parameters of TinySLAM; mapping with known poses uses the map parameters.

    Defaults follow the program OSLL/tiny-slam-ros-cpp; see `docs/notes/slam.md`.
    """

    sigma_xy: NotNegative = 0.2
    """Initial standard deviation of candidate positions per axis [m]."""
    sigma_theta: NotNegative = 0.1
    """Initial standard deviation of candidate headings [rad]."""
    max_failed: Count = 20
    """Failed candidates after which the search ends."""
    max_tries: Count = 100
    """Maximum number of candidates per scan."""
    occupied_prob: Share = 0.95
    """Observed occupancy of a beam's end cell; a cell stores the mean of its observations."""
    empty_prob: Share = 0.01
    """Observed occupancy of cells that a beam passes."""
    quality: Share = 0.9
    """Weight in the map of a scan at a matched pose."""
    raw_quality: Share = 0.6
    """Weight in the map of a scan at a predicted pose."""
    unvisited: Annotated[float, Field(ge=-1, le=1)] = -1.0
    """Occupancy of unobserved cells in scan matching."""
    hole_width: NotNegative = 1.5
    """Length of the occupancy ramp in front of a hit [m]; 0 for no ramp."""
    blur: Literal["add", "assign"] = "add"
    """Add the ramp to a passed cell's occupancy ("add", original) or replace that occupancy ("assign")."""
    prior_weight: NotNegative = 0.0
    """Cost of the squared Mahalanobis distance from the predicted pose; one hit costs up to 1. 0 ignores odometry
    (original)."""
    match_every_scan: bool = True
    """Match every scan instead of only key scans."""
    odometry: Literal["robot_frame", "odometry_frame"] = "robot_frame"
    """Frame of odometry motion. The original's "odometry_frame" is wrong if odometry and map frame are rotated."""
    min_travel_distance: NotNegative = 0.0
    min_travel_angle: NotNegative = 0.0
    resolution: Positive = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class MatchingParams(SlamParams):
    """Parameters of Gauss-Newton scan matching to log-odds maps."""

    residual_variance: Positive = 0.5
    """Variance of a hit's residual, 1 - occupancy: weighs scan against odometry; increased for correlated errors."""
    num_levels: Annotated[int, Field(ge=1, le=6)] = 2
    """Number of map resolutions; the cell side doubles per level."""
    iterations: Count = 6
    """Maximum Gauss-Newton steps on the finest level."""
    coarse_iterations: Count = 4
    """Maximum Gauss-Newton steps on each coarser level."""
    search_distance: NotNegative | None = None
    """Distance between matched scans above which a correlative search runs [m]; None for never."""
    search_angle: NotNegative | None = None
    """Turn between matched scans above which a correlative search runs [rad]; None for never."""
    retry_below: Share = 0.5
    """Mean occupancy of known cells under the hits, below which a wider correlative search runs; 0 for never. GMapping
    searches if particles with half of the weight are below."""
    retry_distance: Positive = 0.8
    """Half width of the wider search [m]. GMapping: also maximum distance of a match from odometry."""
    retry_angle: Positive = 0.35
    """Half angle of the wider search [rad]."""
    retry_gain: NotNegative = 0.05
    """Minimum known-cell occupancy gain per hit to accept the wider search."""
    min_known_score: Share = 0.7
    """Minimum mean occupancy of known cells under the hits; otherwise the scan mismatches, and the pose follows
    odometry."""
    min_known_hits: Count = 20
    """Minimum hits in known cells to judge a match."""
    lost_scans: Count = 3
    """Consecutive mismatched scans after which the robot is lost."""
    max_position_std: Positive = 1.0
    """Position standard deviation in the worst direction above which the robot is lost [m]."""
    occupied_prob: Annotated[float, Field(gt=0.5, lt=1)] = 0.9
    """Observed occupancy probability of a beam's end cell."""
    empty_prob: Annotated[float, Field(gt=0, lt=0.5)] = 0.4
    """Observed occupancy probability of cells that a beam passes."""
    max_log_odds: Annotated[float, Field(gt=0, le=63)] = 50.0
    """Maximum absolute log-odds of a cell."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class HectorParams(MatchingParams):
    """Parameters of `Hector`."""

    uses_odometry: bool = True
    """Use odometry as prediction and prior; False starts at the last pose (Kohlbrecher et al., 2011)."""
    match_every_scan: bool = False
    """Match every scan instead of only key scans."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class LoopClosureParams:
    """Acceptance criteria for a loop closure."""

    min_score: Share = 0.4
    """Minimum mean occupancy under the hits."""
    min_occupied: Share = 0.5
    """Minimum fraction of hits on or next to occupied cells."""
    max_free: Share = 0.15
    """Maximum fraction of hits in free cells without an occupied neighbour."""
    min_agreement: Share = 0.75
    """Minimum fraction of known hits on or next to occupied cells."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GraphSlamParams(HectorParams):
    """Parameters of `GraphSlam`: scan-to-submap matching, pose graph.

    Every integrated scan is a node. Submaps have fewer known cells than maps, hence different defaults.
    """

    min_travel_angle: NotNegative = 0.3
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    submap_spacing: Count = 20
    """Nodes between submap starts; a submap holds twice as many."""
    correlation: Positive = 5.0
    """Factor on the covariance of a node in its submap, for correlated errors of neighbouring nodes."""
    node_sigma_xy: Positive = 0.03
    """Minimum position standard deviation of a node in its submap [m]."""
    node_sigma_theta: Positive = 0.008
    """Minimum heading standard deviation of a node in its submap [rad]."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """Acceptance criteria for loop closures."""
    loop_every: Count = 2
    """Number of nodes between loop-closure searches."""
    submap_every: Count = 6
    """Minimum nodes between searches of the same submap."""
    max_candidates: Count = 2
    """Maximum submaps searched per node."""
    loop_scans: Count = 5
    """Number of recent scans matched together in a loop-closure search."""
    max_evaluations: Count = 20_000
    """Maximum branch-and-bound nodes scored per loop-closure search."""
    max_rendered: Count = 8
    """Number of finished submaps with cached search fields."""
    phi: Positive = 9.0
    """Chi-square above which loop constraints are down-weighted."""
    max_chi2: Positive = 54.0
    """Chi-square above which loop constraints are dropped."""
    optimise_every: Count = 10
    """Number of nodes with new loop closures that trigger an optimisation."""
    urgent_correction: NotNegative = 0.1
    """Loop-closure correction above which the graph is optimised at once [m]."""
    max_iterations: Count = 5
    """Maximum iterations per optimisation, one per key scan."""
    tolerance: Positive = 1e-4
    """Pose change that ends the optimisation [m or rad]."""
    redraw_distance: NotNegative = 0.1
    """Node displacement by optimisation above which the map is rendered again [m]."""
    redraw_angle: NotNegative = 0.02
    """Node rotation by optimisation above which the map is rendered again [rad]."""
    cells_per_scan: Count = 1_000_000
    """Maximum number of cells along beams rendered per key scan; at least one node is rendered."""
    final_passes: Annotated[int, Field(ge=0)] = 1
    """Number of times that `finish` matches all nodes to the rendered map."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GMappingParams(MatchingParams):
    """Parameters of `GMapping`."""

    match_every_scan: ClassVar[bool] = False
    """Constant: only key scans are matched."""
    uses_odometry: ClassVar[bool] = True
    """Constant: odometry is the motion model."""
    num_levels: Annotated[int, Field(ge=1, le=4)] = 2
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    min_travel_distance: NotNegative = 0.3
    min_travel_angle: NotNegative = 0.3
    num_particles: Count = 20
    """Number of particles."""
    likelihood_gain: Annotated[float, Field(gt=0, le=1)] = 0.2
    """Exponent of the scan likelihood in importance weights; below 1 for correlated errors of successive scans."""
    resample_below: Share = 0.5
    """Effective sample size, as a fraction of the particles, below which particles are resampled."""
    switch_margin: NotNegative = 2.0
    """Log-likelihood margin over the best particle (with `likelihood_gain`) for another particle to become best."""


Params = TinySlamParams | HectorParams | GraphSlamParams | GMappingParams
KINDS: dict[str, type[Any]] = {
    "tinyslam": TinySlamParams,
    "hector": HectorParams,
    "graph": GraphSlamParams,
    "gmapping": GMappingParams,
}
"""Parameter classes by SLAM name."""
PRESETS: dict[str, dict[str, Path]] = {
    slam: {path.stem: path for path in sorted((Path(__file__).parent / "presets" / slam).glob("*.yaml"))}
    for slam in KINDS
}
"""Preset files by SLAM name and preset name."""


def load_params(preset: str | Path | Any, changes: Mapping[str, Any] | None = None, slam: str = "tinyslam") -> Any:
    """Return the parameters of a SLAM, with changes.

    Args:
        preset: preset name, YAML file, `module:attribute`, or parameters.
        changes: values to replace; numeric text is converted.
        slam: key of `PRESETS`; "tinyslam" for known poses.

    Raises:
        ValueError: for an unknown name or key, or an invalid value.
        FileNotFoundError: if the file does not exist.
    """
    found = resolve(preset, dict(PRESETS[slam]), f"preset of {slam}", files=True)
    values = read_mapping(found) if isinstance(found, Path) else asdict(found)
    source = str(found) if isinstance(found, Path) else "params"
    return parse_record({**values, **(changes or {})}, source, KINDS[slam])
