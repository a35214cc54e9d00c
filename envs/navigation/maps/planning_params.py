"""Parameters of planning and navigation."""

import math
from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat
from pydantic.dataclasses import dataclass

from lidarnaut.envs.navigation.maps.costmap import CostmapParams

Samples = Annotated[int, Field(ge=1, le=200)]
Granularity = Annotated[float, Field(ge=0.005, le=1.0)]
Weight = Annotated[float, Field(ge=0, le=1e6)]


@dataclass(frozen=True, slots=True)
class PlanningParams:
    """Parameters of path planning and frontier detection."""

    cell: PositiveFloat = 0.1
    """Side of a planning cell, a block of map cells, at most the robot's radius [m]."""
    padding: NonNegativeFloat = 0.03
    """Footprint padding in planning [m], for half a map cell and noise of the pose estimate."""
    tight_radii: tuple[PositiveFloat, ...] = (1.0, 0.75, 0.5)
    """Footprint radii tried in order if the padded footprint does not fit, as fractions of the robot's radius."""
    inflation: NonNegativeFloat = 0.45
    """Width of the zone with increased costs around the footprint [m]."""
    cost_scaling_factor: NonNegativeFloat = 4.0
    """Exponential decay rate of the inflation cost with distance [1/m]."""
    marking_range: NonNegativeFloat = 2.5
    """Maximum range for marking scanned obstacles that the map lacks [m] (Nav2's `obstacle_max_range`)."""
    clearing_range: NonNegativeFloat = 3.0
    """Maximum range for clearing marked obstacles along beams [m] (Nav2's `raytrace_max_range`)."""
    min_lengths: tuple[NonNegativeFloat, ...] = (0.4, 0.15)
    """Minimum frontier lengths [m], tried in order until a frontier is reachable."""
    max_extent: NonNegativeFloat = 2.0
    """Maximum extent of a frontier [m]. Longer frontiers are split."""
    view_distances: tuple[NonNegativeFloat, ...] = (0.0, 0.3, 0.6, 1.0)
    """Maximum viewing distances to a frontier [m], tried in order until a reachable cell sees the frontier."""

    def costmap(self, robot_radius: float) -> CostmapParams:
        """Return inflation parameters for a footprint radius [m]."""
        return CostmapParams(robot_radius, robot_radius + self.inflation, self.cost_scaling_factor)


@dataclass(frozen=True, slots=True)
class NavigatorParams:
    """Parameters of drives: end conditions and recovery."""

    min_time: NonNegativeFloat = 1.0
    """Minimum drive time before a vanished frontier ends the drive [s]."""
    goal_tolerance: NonNegativeFloat = 1.6
    """Distance to the goal that counts as arrival, in robot radii, limited by `max_goal_tolerance`."""
    max_goal_tolerance: NonNegativeFloat = 0.2
    """Maximum distance to the goal that counts as arrival [m]."""
    frontier_radius: NonNegativeFloat = 0.4
    """Radius around the chosen frontier [m]; the drive ends early when no frontier cell is left inside."""
    max_recoveries: NonNegativeInt | None = 3
    """Maximum number of recovery attempts per drive; None without limit."""
    stuck_distance: NonNegativeFloat = 0.5
    """Minimum distance to cover within `stuck_time` [m]; otherwise the drive fails."""
    stuck_time: NonNegativeFloat = 10.0
    """The drive fails if the robot moves less than `stuck_distance` within this time [s]."""


@dataclass(frozen=True, slots=True)
class DwbParams:
    """Parameters of the local planner DWB, with names and values of Nav2's bring-up file. The robot limits speeds."""

    max_vel_x: PositiveFloat = math.inf
    """Maximum forward speed [m/s]."""
    max_vel_theta: PositiveFloat = 1.0
    """Maximum yaw rate [rad/s]."""
    acc_lim_x: PositiveFloat | None = None
    """Forward acceleration in simulated trajectories [m/s2]; None for that of the robot."""
    acc_lim_theta: PositiveFloat | None = None
    """Yaw acceleration in simulated trajectories [rad/s2]; None for that of the robot."""
    vx_samples: Samples = 20
    """Number of sampled forward speeds."""
    vtheta_samples: Samples = 20
    """Number of sampled yaw rates."""
    sim_time: Annotated[float, Field(gt=0, le=10)] = 1.7
    """Duration of a simulated trajectory [s]."""
    linear_granularity: Granularity = 0.05
    """Maximum distance between poses of a trajectory [m]."""
    angular_granularity: Granularity = 0.025
    """Maximum turn between poses of a trajectory [rad]."""
    xy_goal_tolerance: PositiveFloat = 0.25
    """Distance to the goal that starts the final turn [m]."""
    trans_stopped_velocity: PositiveFloat = 0.25
    """Forward speed below which the robot turns at the goal [m/s]; a faster robot brakes first."""
    slowing_factor: NonNegativeFloat = 5.0
    """Weight of the squared forward speed while the robot brakes at the goal [s2/m2]."""
    forward_point_distance: NonNegativeFloat = 0.1
    """Distance from the robot to the point ahead that the alignment critics score [m]."""
    x_only_threshold: NonNegativeFloat = 0.05
    """Forward speed above which changes of the turning direction do not count as oscillation [m/s]."""
    oscillation_reset_dist: NonNegativeFloat = 0.05
    """Distance from the last reversal beyond which the robot may reverse again [m]."""
    oscillation_reset_angle: NonNegativeFloat = 0.2
    """Turn since the last reversal beyond which the robot may reverse again [rad]."""
    base_obstacle_scale: Weight = 0.02
    """Weight of the traversal cost along the trajectory."""
    path_align_scale: Weight = 32.0
    """Weight of the distance from the path, for the point ahead of the final pose."""
    goal_align_scale: Weight = 24.0
    """Weight of the distance from the local goal, for the point ahead of the final pose."""
    path_dist_scale: Weight = 32.0
    """Weight of the distance from the path, for the final position."""
    goal_dist_scale: Weight = 24.0
    """Weight of the distance from the local goal, for the final position."""
    rotate_to_goal_scale: Weight = 32.0
    """Weight of the final heading error near the goal."""
    width: Annotated[float, Field(gt=0, le=20)] = 3.0
    """Minimum side of the square local costmap [m]; larger if trajectories are longer."""
    resolution: Annotated[float, Field(ge=0.02, le=1)] = 0.05
    """Cell side of the local costmap [m]."""
    inflation_radius: PositiveFloat | None = None
    """Distance from obstacles within which costs increase [m], at least the robot's radius; None for 0.48 m more."""
    cost_scaling_factor: NonNegativeFloat = 3.0
    """Exponential decay rate of the inflation cost with distance [1/m]."""
