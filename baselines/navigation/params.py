"""Parameters of the navigator on a known map."""

from dataclasses import dataclass

from envs.navigation import NavigatorParams, PlanningParams

_PLANNING, _NAVIGATION = PlanningParams(), NavigatorParams()


@dataclass(frozen=True, slots=True)
class MapNavigatorParams:
    """How to drive to a goal."""

    local_planner: str = "rpp"
    """What follows paths; see `LOCAL_PLANNERS`."""
    padding: float = _PLANNING.padding
    """Footprint padding: added to the robot's radius in plans [m]."""
    tight_radii: tuple[float, ...] = (1.0, 0.75)
    """Shares of the robot's radius that plans fall back on, in this order, where there is no path otherwise."""
    inflation: float = _PLANNING.inflation
    """How far beyond that nearness to obstacles costs [m]."""
    cost_scaling_factor: float = _PLANNING.cost_scaling_factor
    """Rate at which that cost decays with the distance [1/m]."""
    allow_unknown: bool = False
    """Whether paths may cross what neither map nor scans know."""
    goal_tolerance: float = 0.15
    """Distance at which a goal counts as reached [m]."""
    heading_tolerance: float = 0.15
    """Turn at which a goal's heading counts as reached [rad]."""
    update_period: float = 0.3
    """Time between two scans that are integrated into the costmap [s]."""
    check_period: float = 1.0
    """Time between two checks whether the path is still free [s]."""
    stray_distance: float = 0.5
    """Distance from the path at which another is planned [m]."""
    stall_time: float = _NAVIGATION.stall_time
    """Time without moving or turning after which the robot recovers [s]."""
    stuck_distance: float = _NAVIGATION.stuck_distance
    """A robot that stays within this distance... [m]."""
    stuck_time: float = _NAVIGATION.stuck_time
    """...for this long recovers too [s]."""
    max_recoveries: int = 6
    """Recovery behaviors after which the goal has failed."""
    lost_patience: float = 5.0
    """Time that the robot drives on when the localizer reports that it is lost, once it was localized [s]: along a bare
    wall the pose uncertainty grows and shrinks again."""
    lost_time: float = 90.0
    """Time of reactive driving after that, or at the start [s]."""
    blind_time: float = 5.0
    """Time that it waits for a scan in which anything was measured [s]."""


DEFAULTS = MapNavigatorParams()
