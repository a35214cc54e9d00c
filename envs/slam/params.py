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
    """Parameters of every SLAM: odometry, key scans and map size."""

    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Standard deviations of the odometry motion between two matched scans."""
    min_travel_distance: NotNegative = 0.2
    """Distance from the last key scan at which the next scan is integrated [m]; 0 for every scan. At shorter distances,
    a scan is matched to the noise of the previous scan."""
    min_travel_angle: NotNegative = 0.6
    """Change of heading since the last key scan at which the next scan is integrated [rad]."""
    skip_exceeding: bool = False
    """Ignore beams without a return in mapping; otherwise they clear cells up to the maximum range."""
    map_width: Positive = 20.0
    """Initial extent of the map along x [m]; the map grows when needed."""
    map_height: Positive = 20.0
    """Initial extent of the map along y [m]; the map grows when needed."""
    resolution: Positive = 0.05
    """Side of a map cell at the finest level [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class TinySlamParams(SlamParams):
    """Parameters of TinySLAM; mapping with known poses uses only the map parameters.

    Defaults follow the program OSLL/tiny-slam-ros-cpp; `docs/notes/slam.md` compares them with its launch file, with
    Nguyen et al. (TinySLAM for a robot vacuum, 2025), and with the environments.
    """

    sigma_xy: NotNegative = 0.2
    """Initial standard deviation of candidate positions around the best pose, per axis [m]."""
    sigma_theta: NotNegative = 0.1
    """Initial standard deviation of candidate headings around the best pose [rad]."""
    max_failed: Count = 20
    """Number of candidates without improvement after which the search ends."""
    max_tries: Count = 100
    """Maximum number of candidate poses per scan."""
    occupied_prob: Share = 0.95
    """Observed occupancy of the cell where a beam ends. A cell stores the mean of its observations."""
    empty_prob: Share = 0.01
    """Observed occupancy of the cells that a beam passes."""
    quality: Share = 0.9
    """Weight in the map of a scan with a matched pose."""
    raw_quality: Share = 0.6
    """Weight in the map of a scan integrated at the predicted pose."""
    unvisited: Annotated[float, Field(ge=-1, le=1)] = -1.0
    """Occupancy of unobserved cells in scan matching."""
    hole_width: NotNegative = 1.5
    """Length of the ramp in front of a hit over which occupancy rises [m]; 0 for no ramp."""
    blur: Literal["add", "assign"] = "add"
    """Add the ramp to the occupancy of a passed cell ("add", as the original), or replace that occupancy ("assign")."""
    prior_weight: NotNegative = 0.0
    """Weight of the squared Mahalanobis distance from the predicted pose in the matching cost. The cost without prior
    is the number of hits minus the sum of their cells' occupancies. 0 for no prior (original)."""
    match_every_scan: bool = True
    """Match every scan; False matches only key scans, and the pose between them follows odometry."""
    odometry: Literal["robot_frame", "odometry_frame"] = "robot_frame"
    """Frame in which the odometry motion is applied. "odometry_frame" follows the original; it is wrong once odometry
    and map frame are rotated against each other."""
    min_travel_distance: NotNegative = 0.0
    min_travel_angle: NotNegative = 0.0
    resolution: Positive = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class MatchingParams(SlamParams):
    """Parameters of the SLAMs that match scans to log-odds maps by Gauss-Newton."""

    residual_variance: Positive = 0.5
    """Variance of a hit's residual, 1 - occupancy: weighs the scan against odometry. It exceeds the variance of single
    hits because errors within a scan are correlated."""
    num_levels: Annotated[int, Field(ge=1, le=6)] = 2
    """Number of map resolutions for matching; the cell side doubles with each coarser level."""
    iterations: Count = 6
    """Maximum number of Gauss-Newton steps on the finest level."""
    coarse_iterations: Count = 4
    """Maximum number of Gauss-Newton steps on each coarser level."""
    search_distance: NotNegative | None = None
    """Distance since the last matched scan above which a correlative search precedes Gauss-Newton [m]; None for never."""
    search_angle: NotNegative | None = None
    """Turn since the last matched scan above which a correlative search precedes Gauss-Newton [rad]; None for never."""
    retry_below: Share = 0.5
    """Mean occupancy of known cells under the hits below which a second, wider correlative search runs; 0 for never.
    GMapping: particles with half of the total weight must be below."""
    retry_distance: Positive = 0.8
    """Half width of the second correlative search [m]. GMapping: also the maximum distance of a match from the odometry
    pose."""
    retry_angle: Positive = 0.35
    """Half angle of the second correlative search [rad]."""
    retry_gain: NotNegative = 0.05
    """Minimum gain of known-cell occupancy per hit for the second search to replace the first match."""
    min_known_score: Share = 0.7
    """Minimum mean occupancy of known cells under the hits. A scan below it does not match: it is not integrated, and
    the pose follows odometry."""
    min_known_hits: Count = 20
    """Minimum number of hits in known cells for deciding whether a scan matches."""
    lost_scans: Count = 3
    """Consecutive mismatched scans after which the robot is lost."""
    max_position_std: Positive = 1.0
    """Standard deviation of the position, in its least certain direction, above which the robot is lost [m]."""
    occupied_prob: Annotated[float, Field(gt=0.5, lt=1)] = 0.9
    """Observed occupancy probability of the cell where a beam ends."""
    empty_prob: Annotated[float, Field(gt=0, lt=0.5)] = 0.4
    """Observed occupancy probability of the cells that a beam passes."""
    max_log_odds: Annotated[float, Field(gt=0, le=63)] = 50.0
    """Maximum absolute log-odds of a cell."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class HectorParams(MatchingParams):
    """Parameters of `Hector`, with the defaults of the environments."""

    uses_odometry: bool = True
    """Predict the pose by odometry, and use odometry as the prior of the match; False starts at the pose of the last
    scan (Kohlbrecher et al., 2011)."""
    match_every_scan: bool = False
    """Match every scan; False matches only key scans."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class LoopClosureParams:
    """Acceptance criteria for a loop closure."""

    min_score: Share = 0.4
    """Minimum mean occupancy of the cells under the hits."""
    min_occupied: Share = 0.5
    """Minimum fraction of hits on or next to occupied cells."""
    max_free: Share = 0.15
    """Maximum fraction of hits in free cells without an occupied neighbour."""
    min_agreement: Share = 0.75
    """Minimum fraction of hits on or next to occupied cells, among hits with known cells."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GraphSlamParams(HectorParams):
    """Parameters of `GraphSlam`: Hector's for scan-to-submap matching, and the pose graph's.

    Every integrated scan is a node. Defaults differ from Hector's because submaps have fewer known cells than maps.
    """

    min_travel_angle: NotNegative = 0.3
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    submap_spacing: Count = 20
    """Number of nodes between the starts of two submaps; a submap holds twice as many nodes."""
    correlation: Positive = 5.0
    """Covariance factor of a node in its submap, for the correlation of errors between neighbouring nodes."""
    node_sigma_xy: Positive = 0.03
    """Minimum standard deviation of a node's position in its submap [m]."""
    node_sigma_theta: Positive = 0.008
    """Minimum standard deviation of a node's heading in its submap [rad]."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """Acceptance criteria for loop closures."""
    loop_every: Count = 2
    """Number of nodes between loop-closure searches."""
    submap_every: Count = 6
    """Minimum number of nodes between two searches of the same submap."""
    max_candidates: Count = 2
    """Maximum number of submaps searched per node."""
    loop_scans: Count = 5
    """Number of recent scans that a loop-closure search matches together."""
    max_evaluations: Count = 20_000
    """Maximum number of branch-and-bound nodes scored per search."""
    max_rendered: Count = 8
    """Number of finished submaps with cached search fields."""
    phi: Positive = 9.0
    """Chi-square above which loop constraints are down-weighted."""
    max_chi2: Positive = 54.0
    """Chi-square above which loop constraints are dropped."""
    optimise_every: Count = 10
    """Number of nodes with new loop closures that starts an optimisation."""
    urgent_correction: NotNegative = 0.1
    """Pose correction of a single loop closure above which optimisation starts at once [m]."""
    max_iterations: Count = 5
    """Maximum number of iterations per optimisation; each key scan runs one iteration."""
    tolerance: Positive = 1e-4
    """Pose change below which the optimisation ends [m or rad]."""
    redraw_distance: NotNegative = 0.1
    """Node displacement by optimisation above which the map is rendered again [m]."""
    redraw_angle: NotNegative = 0.02
    """Node rotation by optimisation above which the map is rendered again [rad]."""
    cells_per_scan: Count = 1_000_000
    """Maximum number of beam cells rendered into a corrected map per key scan; at least one node is rendered."""
    final_passes: Annotated[int, Field(ge=0)] = 1
    """Number of passes in which `finish` matches all nodes to the map rendered from them."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GMappingParams(MatchingParams):
    """Parameters of `GMapping`, with the defaults of the environments."""

    match_every_scan: ClassVar[bool] = False
    """False: only key scans are matched."""
    uses_odometry: ClassVar[bool] = True
    """True: odometry is the motion model of the particles."""
    num_levels: Annotated[int, Field(ge=1, le=4)] = 2
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    min_travel_distance: NotNegative = 0.3
    min_travel_angle: NotNegative = 0.3
    num_particles: Count = 20
    """Number of particles, each with its own map."""
    likelihood_gain: Annotated[float, Field(gt=0, le=1)] = 0.2
    """Exponent of the likelihood in the importance weights. Values below 1 account for correlated errors of successive
    scans, and prevent a few particles from taking all weight."""
    resample_below: Share = 0.5
    """Effective sample size, as a fraction of the number of particles, below which particles are resampled."""
    switch_margin: NotNegative = 2.0
    """Margin of accumulated log likelihood (times `likelihood_gain`) by which another particle must exceed the best
    particle to replace it."""


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
    """Return the parameters of a preset, with changes.

    Args:
        preset: preset name, path of a YAML file, `module:attribute`, or parameters.
        changes: values to replace; numeric text is converted.
        slam: key of `PRESETS`; mapping with known poses uses "tinyslam".

    Raises:
        ValueError: for an unknown name or key, or an invalid value; the message names file and key.
        FileNotFoundError: if the path does not exist.
    """
    found = resolve(preset, dict(PRESETS[slam]), f"preset of {slam}", files=True)
    values = read_mapping(found) if isinstance(found, Path) else asdict(found)
    source = str(found) if isinstance(found, Path) else "params"
    return parse_record({**values, **(changes or {})}, source, KINDS[slam])
