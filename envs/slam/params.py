"""Parameters of all SLAMs, and the presets that come with them."""

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
    """What all SLAMs share: odometry, key scans and the extent of the map."""

    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Standard deviations of odometry's motion from one matched scan to the next."""
    min_travel_distance: NotNegative = 0.2
    """A scan is integrated once the robot is this far from where the last one was [m]; 0 for every scan. Integrated
    more often, a scan is matched to the noise of the one before rather than to the environment."""
    min_travel_angle: NotNegative = 0.6
    """... or once it has turned by this much since [rad]."""
    skip_exceeding: bool = False
    """Whether beams without a return are left out of the map; else they clear it up to the lidar's range."""
    map_width: Positive = 20.0
    """Extent of a new map along x [m]; it grows when needed."""
    map_height: Positive = 20.0
    """Extent of a new map along y [m]; it grows when needed."""
    resolution: Positive = 0.05
    """Side of a cell, of the finest map where there are several [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class TinySlamParams(SlamParams):
    """All params of TinySLAM, and of mapping with known poses, which uses those of the map.

    Defaults are those of the original's program code (OSLL/tiny-slam-ros-cpp); `docs/notes/slam.md` compares them with
    the original's launch file, with Nguyen et al. (TinySLAM for a robot vacuum, 2025), and with what the environments
    use.
    """

    sigma_xy: NotNegative = 0.2
    """Spread of candidates around the best pose so far, per axis, at the start of a scan [m]."""
    sigma_theta: NotNegative = 0.1
    """Spread of candidates' headings around the best so far, at the start of a scan [rad]."""
    max_failed: Count = 20
    """Candidates that may fail to improve before the search ends."""
    max_tries: Count = 100
    """Candidates that may be tried for one scan."""
    occupied_prob: Share = 0.95
    """Occupancy that a beam reports of the cell it ends in. A cell holds the mean of all reports."""
    empty_prob: Share = 0.01
    """Occupancy that a beam reports of the cells it passes."""
    quality: Share = 0.9
    """Weight of a scan whose pose the matcher has corrected."""
    raw_quality: Share = 0.6
    """Weight of a scan mapped at the predicted pose."""
    unvisited: Annotated[float, Field(ge=-1, le=1)] = -1.0
    """Occupancy that the matcher assumes of cells never observed."""
    hole_width: NotNegative = 1.5
    """Depth of the ramp in front of a hit over which occupancy rises [m]. 0 for none."""
    blur: Literal["add", "assign"] = "add"
    """Whether the ramp is added to the occupancy of a passed cell (the original) or replaces it (its successor)."""
    prior_weight: NotNegative = 0.0
    """What a squared standard deviation from the predicted pose adds to the cost of a candidate, which is the number of
    hits less the sum of their cells' occupancies; 0 for a search that odometry does not hold (the original)."""
    match_every_scan: bool = True
    """Whether every scan is matched; else only those that are integrated are, and between them the pose follows
    odometry."""
    odometry: Literal["robot_frame", "odometry_frame"] = "robot_frame"
    """Whether motion is applied along the estimated heading, or added as odometry's own frame sees it, as the originals
    do, which is wrong as soon as the two frames are turned against each other."""
    min_travel_distance: NotNegative = 0.0
    min_travel_angle: NotNegative = 0.0
    resolution: Positive = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class MatchingParams(SlamParams):
    """What the SLAMs that match scans by Gauss-Newton steps to maps of log odds share."""

    residual_variance: Positive = 0.5
    """Variance of a hit's residual, 1 minus the occupancy where it falls: weighs the scan against odometry, and
    particles against each other. The hits of a scan err together, and so this exceeds what a single one shows."""
    num_levels: Annotated[int, Field(ge=1, le=6)] = 2
    """Maps that the matcher works on, from the coarsest to the finest; each has cells twice as wide as the next."""
    iterations: Count = 6
    """Greatest number of Gauss-Newton steps on the finest map."""
    coarse_iterations: Count = 4
    """Greatest number of Gauss-Newton steps on each of the others."""
    search_distance: NotNegative | None = None
    """Motion since the last matched scan from which on a correlative search precedes Gauss-Newton [m]; None for
    never."""
    search_angle: NotNegative | None = None
    """... or turn since then [rad]; None for never."""
    retry_below: Share = 0.5
    """Mean occupancy of the known cells under the hits below which a second correlative search looks farther around; of
    particles, those with half of the weight must stay below; 0 for never."""
    retry_distance: Positive = 0.8
    """Half width of the second search; of particles, also how far any match may be off the pose by odometry [m]."""
    retry_angle: Positive = 0.35
    """Half width of the second search in heading [rad]."""
    retry_gain: NotNegative = 0.05
    """What the second search must add to the occupancies of the known cells under the hits, for each hit."""
    min_known_score: Share = 0.7
    """A scan whose hits on known cells fall on less occupied ones in the mean does not match: it is not integrated, and
    the pose follows odometry."""
    min_known_hits: Count = 20
    """Hits on known cells without which a scan is not judged."""
    lost_scans: Count = 3
    """Scans in succession that do not match, from which on the robot is lost."""
    max_position_std: Positive = 1.0
    """Standard deviation of the position along its worst direction from which on the robot is lost [m]."""
    occupied_prob: Annotated[float, Field(gt=0.5, lt=1)] = 0.9
    """Occupancy that a beam reports of the cell it ends in."""
    empty_prob: Annotated[float, Field(gt=0, lt=0.5)] = 0.4
    """Occupancy that a beam reports of the cells it passes."""
    max_log_odds: Annotated[float, Field(gt=0, le=63)] = 50.0
    """Largest log odds of a cell, and with the opposite sign the least."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class HectorParams(MatchingParams):
    """All params of `Hector`. The defaults are those of the environments."""

    uses_odometry: bool = True
    """Whether odometry predicts the pose, and is the prior of the match; else the search starts at the pose of the scan
    before (Kohlbrecher et al., 2011)."""
    match_every_scan: bool = False
    """See `TinySlamParams`."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class LoopClosureParams:
    """When a loop closure is accepted."""

    min_score: Share = 0.4
    """Least mean occupancy of the cells in which hits fall."""
    min_occupied: Share = 0.5
    """Least share of hits on or next to occupied cells."""
    max_free: Share = 0.15
    """Largest share of hits in free cells away from occupied ones."""
    min_agreement: Share = 0.75
    """Least share of hits on or next to occupied cells among those that do not fall into unknown ones."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GraphSlamParams(HectorParams):
    """All params of `GraphSlam`: those of Hector, which match scans with submaps, and those of the graph.

    A scan that is integrated is a node; `min_travel_distance` and `min_travel_angle` lie between two of them. Submaps
    are smaller than maps, and less of a scan falls in known cells, hence other defaults.
    """

    min_travel_angle: NotNegative = 0.3
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    submap_spacing: Count = 20
    """A submap starts every so many nodes, and takes twice as many."""
    correlation: Positive = 5.0
    """Factor of the covariance of a node in its submap: errors of neighbours are correlated."""
    node_sigma_xy: Positive = 0.03
    """Least standard deviation of a node in its submap [m]."""
    node_sigma_theta: Positive = 0.008
    """The same of the heading [rad]."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """When loop closures are accepted."""
    loop_every: Count = 2
    """Loop closures are searched at every so many nodes."""
    submap_every: Count = 6
    """Nodes between two searches of the same submap."""
    max_candidates: Count = 2
    """Most submaps that are searched at one node."""
    loop_scans: Count = 5
    """Scans that are matched together."""
    max_evaluations: Count = 20_000
    """Most poses and groups of poses that a search scores."""
    max_rendered: Count = 8
    """Finished submaps whose fields are kept; others are rendered when they are searched."""
    phi: Positive = 9.0
    """Chi^2 above which loop constraints weigh less."""
    max_chi2: Positive = 54.0
    """Chi^2 above which loop constraints are dropped."""
    optimise_every: Count = 10
    """Nodes with loop closures before the graph is optimised."""
    urgent_correction: NotNegative = 0.1
    """Correction that starts the optimisation at once [m]."""
    max_iterations: Count = 5
    """Most iterations of one optimisation; one is done per key scan."""
    tolerance: Positive = 1e-4
    """Largest change that ends an optimisation [m or rad]."""
    redraw_distance: NotNegative = 0.1
    """The map is rendered anew once an optimisation has moved a node by more than this in it [m]"""
    redraw_angle: NotNegative = 0.02
    """... or turned one by more than this [rad]."""
    cells_per_scan: Count = 1_000_000
    """Cells along the beams of nodes that are rendered into a corrected map at each key scan, and those of one node."""
    final_passes: Annotated[int, Field(ge=0)] = 1
    """How often `finish` matches all nodes with the map that is rendered from them."""


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class GMappingParams(MatchingParams):
    """All params of `GMapping`. The defaults are those of the environments."""

    match_every_scan: ClassVar[bool] = False
    """Key scans alone are matched; see `KeyScanSlam`."""
    uses_odometry: ClassVar[bool] = True
    """The motion model of the particles; see `HectorParams`."""
    num_levels: Annotated[int, Field(ge=1, le=4)] = 2
    retry_below: Share = 0.4
    min_known_score: Share = 0.25
    min_travel_distance: NotNegative = 0.3
    min_travel_angle: NotNegative = 0.3
    num_particles: Count = 20
    """Number of particles, each with a map of its own."""
    likelihood_gain: Annotated[float, Field(gt=0, le=1)] = 0.2
    """Exponent of the likelihood in the importance weights: successive scans err together as well, and without it few
    particles would take all weight."""
    resample_below: Share = 0.5
    """Effective sample size, as a fraction of the particles, below which they are resampled."""
    switch_margin: NotNegative = 2.0
    """Another particle becomes the best one if the log likelihood of all scans along its trajectory, times
    `likelihood_gain`, exceeds that of the best one by more than this."""


Params = TinySlamParams | HectorParams | GraphSlamParams | GMappingParams
KINDS: dict[str, type[Any]] = {
    "tinyslam": TinySlamParams,
    "hector": HectorParams,
    "graph": GraphSlamParams,
    "gmapping": GMappingParams,
}
"""Classes of the params by SLAM."""
PRESETS: dict[str, dict[str, Path]] = {
    slam: {path.stem: path for path in sorted((Path(__file__).parent / "presets" / slam).glob("*.yaml"))}
    for slam in KINDS
}
"""Files of the presets by SLAM and name."""


def load_params(preset: str | Path | Any, changes: Mapping[str, Any] | None = None, slam: str = "tinyslam") -> Any:
    """Return params by the name of a preset, by the path of a YAML file, by `module:attribute`, or as they are.

    `changes`: values to replace, text that reads as a number is taken for it; `slam`: whose they are, a key of
    `PRESETS`; mapping with known poses takes those of "tinyslam". ValueError, naming file and key, for an unknown name
    or key, or a value that makes no sense; FileNotFoundError if there is no file at the path.
    """
    found = resolve(preset, dict(PRESETS[slam]), f"preset of {slam}", files=True)
    values = read_mapping(found) if isinstance(found, Path) else asdict(found)
    source = str(found) if isinstance(found, Path) else "params"
    return parse_record({**values, **(changes or {})}, source, KINDS[slam])
