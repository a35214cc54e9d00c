"""Parameters of graph SLAM."""

import math
from dataclasses import dataclass, field

from envs.slam.matching.score_surface import SurfaceParams

from .loop_closure import LoopClosureParams


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionNoise:
    """Standard deviations of the motion between two scans that are matched."""

    position: float = 0.003
    """Of the position, without motion [m]."""
    position_per_metre: float = 0.02
    """Of the position, per metre driven."""
    heading: float = 0.003
    """Of the heading, without motion [rad]."""
    heading_per_radian: float = 0.03
    """Of the heading, per radian turned."""
    heading_per_metre: float = 0.03
    """Of the heading, per metre driven [rad/m]."""

    def sigmas(self, distance: float, turn: float) -> tuple[float, float]:
        """Return the standard deviations of position [m] and heading [rad] after a motion."""
        turned = self.heading + self.heading_per_radian * abs(turn) + self.heading_per_metre * distance
        return self.position + self.position_per_metre * distance, turned


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphSlamParams:
    """All params of graph SLAM."""

    resolution: float = 0.05
    """Side of a map cell [m]."""
    node_distance: float = 0.2
    """A scan becomes a node once the robot is this far from the last one [m] ..."""
    node_angle: float = 0.3
    """... or has turned by this much since [rad]."""
    match_every_scan: bool = False
    """Whether scans between nodes are matched as well; needed where wheels slip."""
    submap_spacing: int = 20
    """A submap starts every so many nodes, and takes twice as many."""
    residual_variance: float = 1.0
    """Variance of the difference between field and 1 at a hit: weighs the scan against odometry."""
    noise: MotionNoise = field(default_factory=MotionNoise)
    """Of odometry."""
    correlation: float = 5.0
    """Factor of the covariance of a node in its submap: errors of neighbours are correlated."""
    node_sigma_xy: float = 0.03
    """Least standard deviation of a node in its submap [m]."""
    node_sigma_theta: float = 0.008
    """The same of the heading [rad]."""
    loops: LoopClosureParams = field(default_factory=LoopClosureParams)
    """Where loop closures are searched and when they are accepted."""
    surface: SurfaceParams = field(default_factory=SurfaceParams)
    """How the covariance of a loop closure is found."""
    loop_every: int = 2
    """Loop closures are searched at every so many nodes."""
    submap_every: int = 6
    """Nodes between two searches of the same submap."""
    max_candidates: int = 2
    """Most submaps that are searched at one node."""
    loop_scans: int = 5
    """Scans that are matched together."""
    max_evaluations: int = 200_000
    """Most poses and groups of poses that a search scores."""
    max_rendered: int = 8
    """Finished submaps whose fields are kept; others are rendered when they are searched."""
    phi: float = 9.0
    """Chi^2 above which loop constraints weigh less."""
    max_chi2: float = 54.0
    """Chi^2 above which loop constraints are dropped."""
    optimise_every: int = 10
    """Nodes with loop closures before the graph is optimised."""
    urgent_correction: float = 0.1
    """Correction that starts the optimisation at once [m]."""
    max_iterations: int = 5
    """Most iterations of one optimisation; one is done per scan."""
    tolerance: float = 1e-4
    """Largest change that ends an optimisation [m or rad]."""

    def __post_init__(self) -> None:
        for name in ("resolution", "node_distance", "node_angle", "residual_variance", "correlation", "phi"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)!r}")
        for name in (
            "submap_spacing",
            "loop_every",
            "submap_every",
            "loop_scans",
            "max_rendered",
            "optimise_every",
            "max_iterations",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)!r}")
