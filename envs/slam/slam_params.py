import math
from collections.abc import Mapping
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import parse_record, read_mapping, resolve
from lidarnaut.envs.robots import LidarParams, OdometryNoise
from lidarnaut.envs.robots.robot_params import CONFIG, Count, NotNegative, Positive, Share


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class SlamParams:
    """Parameters that all SLAM algorithms share."""

    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Odometry noise model for the motion between two matched scans."""
    min_travel_distance: NotNegative = 0.2
    """Minimum distance between scans inserted into the map [m]; 0 for every scan."""
    min_travel_angle: NotNegative = 0.6
    """Minimum turn between scans inserted into the map [rad]; scans are also inserted after the minimum distance."""
    skip_exceeding: bool = False
    """Whether mapping ignores beams without a return instead of clearing cells along them."""
    median_width: NotNegative = 0.0
    """Width of a median filter over neighbouring beams of a scan [m]; 0 for none. Against range noise that makes walls
    thicker than a map cell."""
    max_range: Positive | None = None
    """Range above which readings count as no return [m]: matching ignores them, mapping clears cells up to this range,
    or ignores the beam (`skip_exceeding`). None for the lidar's maximum range."""
    map_width: Positive = 20.0
    """Initial map size along x [m]; grows when needed."""
    map_height: Positive = 20.0
    """Initial map size along y [m]; grows when needed."""
    resolution: Positive = 0.05
    """Side of a map cell at the finest resolution [m]."""

    def limited(self, lidar: LidarParams) -> LidarParams:
        """Return the lidar with `max_range`; ValueError if it does not exceed `range_min`."""
        if self.max_range is not None and self.max_range <= lidar.range_min:
            raise ValueError(f"max_range must exceed the lidar's range_min {lidar.range_min:g}, got {self.max_range:g}")
        return replace(lidar, range_max=min(self.max_range or math.inf, lidar.range_max))


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class TinySlamParams(SlamParams):
    """Parameters of TinySLAM (Monte Carlo scan matching) and of mapping at known poses.

    Defaults follow the program OSLL/tiny-slam-ros-cpp; see `docs/notes.md`.
    """

    sigma_xy: NotNegative = 0.2
    """Initial standard deviation of sampled positions per axis [m]."""
    sigma_theta: NotNegative = 0.1
    """Initial standard deviation of sampled headings [rad]."""
    max_failed: Count = 20
    """Number of sampled poses without improvement that ends a search."""
    max_tries: Count = 100
    """Maximum number of sampled poses per scan."""
    occupied_prob: Share = 0.95
    """Occupancy observed for the cell of a beam endpoint. A map cell stores the mean of its observations."""
    empty_prob: Share = 0.01
    """Occupancy observed for a cell that a beam passes."""
    quality: Share = 0.9
    """Weight of a scan in the map if scan matching improved the pose."""
    raw_quality: Share = 0.6
    """Weight of a scan in the map if scan matching kept the predicted pose."""
    unvisited: Annotated[float, Field(ge=-1, le=1)] = -1.0
    """Occupancy that scan matching assumes for unobserved cells."""
    hole_width: NotNegative = 1.5
    """Length before a beam endpoint over which occupancy rises from free to occupied [m]; 0 for none."""
    blur: Literal["add", "assign"] = "add"
    """Lowest value of the occupancy rise before a beam endpoint: `empty_prob` ("add", original program) or 0
    ("assign")."""
    occupancy_estimator: Literal["const", "area"] = "const"
    """Observed occupancies: `occupied_prob` and `empty_prob` ("const"), or by the area of the cell that the beam cuts
    off ("area": `AreaOccupancyEstimator` of OSLL/tiny-slam-ros-cpp)."""
    cell_type: Literal["avg", "base"] = "avg"
    """Value of a cell: mean of its observations ("avg"), or p <- (1 - q) p + q p_new from p = 0.5, with scan quality q
    ("base"; original program: `quality=0.2,raw_quality=0.1,unvisited=0.5`)."""
    prior_weight: NotNegative = 0.0
    """Weight of the squared Mahalanobis distance from the predicted pose in the matching cost; 0 for none (original
    program). A scan point in a free cell costs about 1."""
    match_every_scan: bool = True
    """Match every scan instead of only scans after a minimum motion."""
    odometry: Literal["robot_frame", "odometry_frame"] = "robot_frame"
    """Reference frame of odometry displacements. "odometry_frame" (original program) requires parallel axes of odometry
    and map."""
    min_travel_distance: NotNegative = 0.0
    min_travel_angle: NotNegative = 0.0
    resolution: Positive = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class MatchingParams(SlamParams):
    """Parameters of Gauss-Newton scan matching to log-odds maps."""

    residual_variance: Positive = 0.5
    """Variance of the residual (1 - occupancy) at a scan point, to weigh scan against odometry."""
    num_levels: Annotated[int, Field(ge=1, le=6)] = 2
    """Number of map resolutions; the cell side doubles per level."""
    iterations: Count = 6
    """Maximum number of Gauss-Newton steps at the finest resolution."""
    coarse_iterations: Count = 4
    """Maximum number of Gauss-Newton steps at each coarser resolution."""
    search_distance: NotNegative | None = None
    """Distance between matched scans above which an exhaustive search runs first [m]; None for never."""
    search_angle: NotNegative | None = None
    """Turn between matched scans above which an exhaustive search runs first [rad]; None for never."""
    retry_below: Share = 0.5
    """A wider search runs if the mean occupancy of known cells at the scan points is below this; 0 for never. In
    GMapping, half of the particles (by weight) must be below."""
    retry_distance: Positive = 0.8
    """Half width of the wider search after a poor match [m]; in GMapping, also maximum correction of odometry."""
    retry_angle: Positive = 0.35
    """Half angle of the wider search after a poor match [rad]."""
    min_known_score: Share = 0.7
    """Minimum mean occupancy of known cells at the scan points; otherwise the scan does not fit the map, and the pose
    follows odometry."""
    max_position_std: Positive = 1.0
    """Position standard deviation in the most uncertain direction above which the robot is lost [m]."""
    occupied_prob: Annotated[float, Field(gt=0.5, lt=1)] = 0.9
    """Occupancy probability observed for the cell of a beam endpoint."""
    empty_prob: Annotated[float, Field(gt=0, lt=0.5)] = 0.4
    """Occupancy probability observed for a cell that a beam passes."""
    max_log_odds: Annotated[float, Field(gt=0, le=63)] = 50.0
    """Maximum absolute log-odds of a cell."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class HectorParams(MatchingParams):
    """Parameters of Hector SLAM (scan matching on one map)."""

    uses_odometry: bool = True
    """Use odometry as prediction and pose prior; False starts at the last pose (Kohlbrecher et al., 2011)."""
    uses_distributions: bool = True
    """Refine matches with normal distributions of the points in the map (Biber and Straßer, 2003)."""
    match_every_scan: bool = False
    """Match every scan instead of only scans after a minimum motion."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class LoopClosureParams:
    """Acceptance criteria for a loop closure: agreement of scan points with a map."""

    min_score: Share = 0.4
    """Minimum mean occupancy at the scan points."""
    min_occupied: Share = 0.5
    """Minimum fraction of all scan points on or next to occupied cells."""
    max_free: Share = 0.15
    """Maximum fraction of scan points in free cells without occupied neighbours."""
    min_agreement: Share = 0.75
    """Minimum fraction of scan points on or next to occupied cells; points in unknown surroundings are not counted."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GraphSlamParams(HectorParams):
    """Parameters of graph SLAM: scan-to-submap matching, loop closures, pose graph.

    Every scan inserted into the map is a node. Submaps have fewer known cells than maps, hence different defaults.
    """

    min_travel_angle: NotNegative = 0.3
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    submap_spacing: Count = 20
    """Number of nodes (scans) between submap starts; a submap holds twice as many."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """Acceptance criteria for loop closures."""
    loop_every: Count = 2
    """Number of nodes between loop-closure searches."""
    loop_scans: Count = 5
    """Number of recent scans merged for a loop-closure search."""
    linear_search_window: Positive = 4.0
    """Maximum half width of a loop-closure search [m]; the half width grows with the path between the scans."""
    optimise_every: Count = 10
    """Number of successful loop-closure searches after which the pose graph is optimised."""
    optimise_nodes: Count | None = None
    """Number of nodes after which the pose graph is optimised if loops were closed; None for no such limit."""
    urgent_correction: NotNegative = 0.1
    """Position correction by a loop closure above which the pose graph is optimised at once [m]."""
    max_iterations: Count = 5
    """Maximum number of iterations per pose-graph optimisation, spread over time: one per matched scan."""
    tolerance: Positive = 1e-4
    """Pose change below which pose-graph optimisation ends [m or rad]."""
    redraw_distance: NotNegative = 0.1
    """Position change of a node above which the map is rebuilt [m]."""
    redraw_angle: NotNegative = 0.02
    """Heading change of a node above which the map is rebuilt [rad]."""
    cells_per_scan: Count = 1_000_000
    """Maximum work per new scan while the map is rebuilt, in cells along the inserted beams."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GMappingParams(MatchingParams):
    """Parameters of GMapping (Rao-Blackwellised particle filter)."""

    match_every_scan: ClassVar[bool] = False
    uses_odometry: ClassVar[bool] = True
    uses_distributions: ClassVar[bool] = False
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
    """Effective sample size, divided by the number of particles, below which particles are resampled."""
    switch_margin: NotNegative = 2.0
    """Minimum lead in log-likelihood for another particle to replace the best one, whose pose and map are the SLAM
    estimate."""


Params = TinySlamParams | HectorParams | GraphSlamParams | GMappingParams
KINDS: Any = {"tinyslam": TinySlamParams, "hector": HectorParams, "graph": GraphSlamParams, "gmapping": GMappingParams}
"""Parameter class of each SLAM algorithm."""
PRESETS: dict[str, dict[str, Path]] = {
    slam: {path.stem: path for path in sorted((Path(__file__).parent / "presets" / slam).glob("*.yaml"))}
    for slam in KINDS
}
"""Preset YAML files by SLAM name and preset name."""


def load_params(preset: str | Path | Any, changes: Mapping[str, Any] | None = None, slam: str = "tinyslam") -> Any:
    """Load the parameters of a SLAM algorithm, with changes.

    Args:
        preset: preset name, YAML file, `module:attribute`, or parameter object.
        changes: new values by parameter name; numeric text is converted.
        slam: algorithm, a key of `PRESETS`; "tinyslam" for mapping at known poses.

    Raises:
        ValueError: for an unknown name or key, or an invalid value.
        FileNotFoundError: if the file does not exist.
    """
    found = resolve(preset, dict(PRESETS[slam]), f"preset of {slam}", files=True)
    if not isinstance(found, (Path, KINDS[slam])):
        raise ValueError(f"preset of {slam} must be a name, a YAML file or {KINDS[slam].__name__}, got {found!r}")
    values = read_mapping(found) if isinstance(found, Path) else asdict(found)
    source = str(found) if isinstance(found, Path) else "params"
    return parse_record({**values, **(changes or {})}, source, KINDS[slam])
