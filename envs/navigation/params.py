"""Parameters of planning and of drives: every number once, for all explorers, goals and the decision level."""

from dataclasses import dataclass

from lidarnaut.envs.navigation.costmap import CostmapParams


@dataclass(frozen=True, slots=True)
class PlanningParams:
    """How the map is turned into costs, frontiers and candidates."""

    cell: float = 0.1
    """Side of the cells that are planned on, where the robot is at least that wide [m]; map cells are joined."""
    padding: float = 0.03
    """Footprint padding: added to the robot's radius in plans [m], half a map cell and the pose's jitter."""
    tight_radii: tuple[float, ...] = (1.0, 0.75, 0.5)
    """Shares of the robot's radius that plans fall back on when nothing can be reached otherwise (footprint padding
    levels 1, 2, ...): walls of a map that has drifted close gaps that are open in reality; the scan guards the robot.
    """
    inflation: float = 0.45
    """How far beyond that nearness to obstacles costs [m]."""
    cost_scaling_factor: float = 4.0
    """Rate at which that cost decays with the distance [1/m]."""
    marking_range: float = 2.5
    """Obstacles seen this near are marked in plans where the map misses them [m] (Nav2's `obstacle_max_range`): legs of
    chairs are too thin to last in a map."""
    clearing_range: float = 3.0
    """Beams clear the marks that they pass up to this range [m] (Nav2's `raytrace_max_range`)."""
    same_obstacle: float = 0.15
    """Distance up to which an occupied cell of the map accounts for an obstacle in the scan [m]."""
    min_lengths: tuple[float, ...] = (0.4, 0.15)
    """Least length of a frontier [m]; the next one is taken when nothing of the length before can be reached."""
    max_extent: float = 2.0
    """Frontiers longer than this are split into several candidates [m]."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """Distances of viewpoints from a frontier; the first one from which it can be seen is taken [m]."""
    detour: float = 3.0
    """The next view distance is taken, too, where the first costs this much more to get to [m]."""
    view_range: float = 8.0
    """Unknown area in view of a viewpoint is counted up to this distance, where the lidar sees as far [m]."""
    heading_distance: float = 0.6
    """Heading changes are those towards the point of the path this far from its start [m]."""

    def costmap(self, robot_radius: float) -> CostmapParams:
        """Return how obstacles spread for a footprint of a radius [m]."""
        return CostmapParams(robot_radius, robot_radius + self.inflation, self.cost_scaling_factor)


@dataclass(frozen=True, slots=True)
class NavigatorParams:
    """When a drive to a goal ends, and how the robot recovers."""

    min_time: float = 1.0
    """A frontier that vanishes sooner does not end the drive [s]."""
    replan_time: float = 4.0
    """Time between two plans of the path within one drive [s]; drives that are no longer keep to their first plan."""
    goal_tolerance: float = 1.6
    """Distance at which the goal counts as reached, in radii of the robot and at most 0.2 m."""
    frontier_radius: float = 0.4
    """The drive goes on as long as there is a frontier this near to the one that was chosen [m]."""
    stall_time: float = 3.0
    """Time without moving or turning after which the robot recovers [s]."""
    stall_angle: float = 0.3
    """A heading that differs by this much has turned [rad]."""
    max_recoveries: int = 3
    """Attempts to recover after which the drive has failed."""
    stuck_distance: float = 0.5
    """A robot that stays within this distance... [m]."""
    stuck_time: float = 10.0
    """...for this long has failed [s]."""
    still_distance: float = 0.1
    """A robot that runs out of frontiers when it has not come farther than this... [m]"""
    still_time: float = 30.0
    """...for this long could not move: it is stuck [s]."""
    spin_rate: float = 1.0
    """Yaw rate of turns that are made to look around or to recover, where the robot can turn that fast [rad/s]."""
    look_radius: float = 3.0
    """Frontier cells this near to a viewpoint that was visited for them, or to a goal that failed, are ignored from
    then on, in radii of the robot and at most 0.75 m."""
    retry_radius: float = 0.5
    """Goals that failed count as the same goal within this distance [m]."""
    max_failures: int = 3
    """Failures after which a frontier is ignored."""
    max_looks: int = 40
    """How often a robot that has met people looks again where it gets no further, before it says so: somebody may have
    stood in a door."""
