"""Parameters of planning and navigation."""

from dataclasses import dataclass

from lidarnaut.envs.navigation.costmap import CostmapParams


@dataclass(frozen=True, slots=True)
class PlanningParams:
    """Parameters of path planning and frontier detection."""

    cell: float = 0.1
    """Side of a planning cell, a block of map cells, at most the robot's radius [m]."""
    padding: float = 0.03
    """Footprint padding in planning [m], for half a map cell and noise of the pose estimate."""
    tight_radii: tuple[float, ...] = (1.0, 0.75, 0.5)
    """Footprint radii tried in order if the padded footprint does not fit, as fractions of the robot's radius."""
    inflation: float = 0.45
    """Width of the zone with increased costs around the footprint [m]."""
    cost_scaling_factor: float = 4.0
    """Exponential decay rate of the inflation cost with distance [1/m]."""
    marking_range: float = 2.5
    """Maximum range for marking scanned obstacles that the map lacks [m] (Nav2's `obstacle_max_range`)."""
    clearing_range: float = 3.0
    """Maximum range for clearing marked obstacles along beams [m] (Nav2's `raytrace_max_range`)."""
    same_obstacle: float = 0.15
    """Scanned obstacles within this distance of an occupied map cell count as already mapped [m]."""
    min_lengths: tuple[float, ...] = (0.4, 0.15)
    """Minimum frontier lengths [m], tried in order until a frontier is reachable."""
    max_extent: float = 2.0
    """Maximum extent of a frontier [m]. Longer frontiers are split."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """Maximum viewing distances to a frontier [m], tried in order until a reachable cell sees the frontier."""
    detour: float = 3.0
    """Additional path cost accepted for a viewpoint nearer to the frontier [m]."""
    view_range: float = 8.0
    """Radius for counting unknown area in view of a viewpoint [m], limited by the lidar's range."""
    heading_distance: float = 0.6
    """The heading change to a frontier is measured at this distance along its path [m]; an input of policies."""

    def costmap(self, robot_radius: float) -> CostmapParams:
        """Return inflation parameters for a footprint radius [m]."""
        return CostmapParams(robot_radius, robot_radius + self.inflation, self.cost_scaling_factor)


@dataclass(frozen=True, slots=True)
class NavigatorParams:
    """Parameters of drives: end conditions and recovery."""

    min_time: float = 1.0
    """Minimum drive time before a vanished frontier ends the drive [s]."""
    replan_time: float = 4.0
    """Interval between replans of the path during a drive [s]."""
    goal_tolerance: float = 1.6
    """Distance to the goal that counts as arrival, in robot radii, capped at 0.2 m."""
    frontier_radius: float = 0.4
    """Radius around the chosen frontier [m]; the drive ends early when no frontier cell is left inside."""
    stall_time: float = 3.0
    """Time without translation or rotation that triggers a recovery behavior [s]."""
    stall_angle: float = 0.3
    """Minimum heading change that counts as rotation in the detection of stalls [rad]."""
    max_recoveries: int = 3
    """Maximum number of recovery attempts per drive."""
    stuck_distance: float = 0.5
    """Minimum distance to cover within `stuck_time` [m]; otherwise the drive fails."""
    stuck_time: float = 10.0
    """The drive fails if the robot moves less than `stuck_distance` within this time [s]."""
    still_distance: float = 0.1
    """Displacement that shows that the robot is not stuck [m]; see `still_time`."""
    still_time: float = 30.0
    """The robot counts as stuck if it moves less than `still_distance` in this time and no frontier is left [s]."""
    spin_rate: float = 1.0
    """Yaw rate of recovery spins [rad/s], limited by the robot."""
    look_radius: float = 3.0
    """Radius of the area around a frontier that is ignored after `max_failures` failed drives, in robot radii, capped
    at 0.75 m. After a visit, visible frontier cells up to this distance beyond the frontier are ignored."""
    retry_radius: float = 0.5
    """A frontier within this distance of an earlier frontier takes over its age and number of failed drives [m]."""
    max_failures: int = 3
    """Number of failed drives after which a frontier is ignored."""
    max_looks: int = 40
    """Maximum number of retries per episode when people may have blocked the passage to the last frontiers."""
