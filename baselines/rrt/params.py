"""Parameters of exploration by random trees."""

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class RrtParams:
    """Defaults: the launch file of Nguyen et al. (2022), that of the published program for one robot, or ours."""

    eta_local: float = 1.0
    """Longest step of the local tree [m]; launch file."""
    eta_global: float = 15.0
    """Longest step of the global tree [m]; launch file, one robot (1 m with three robots)."""
    bandwidth: float = 0.3
    """Bandwidth of the mean shift [m]; the program's filter."""
    info_radius: float = 1.0
    """Radius around a point in which unknown area is its information gain [m]; launch file."""
    min_gain: float = 0.2
    """Unknown area within half of that radius below which a point is stale [m2]; the program's filter."""
    max_cost: float = 70.0
    """Cost above which a point is invalid, on ROS's scale: 99 touches an obstacle [percent]; launch file."""
    info_multiplier: float = 3.0
    """Lambda: length of path that a unit of gain is worth [1/m]; launch file."""
    hysteresis_radius: float = 3.0
    """Distance from the robot up to which gains are multiplied [m]; launch file."""
    hysteresis_gain: float = 2.0
    """Factor of that multiplication; launch file."""
    num_samples: int = 200
    """Samples per tree and control step; ours (the program takes 10 in 0.1 s, and one for each loop of its own)."""
    spacing: float = 0.3
    """Least distance of a new vertex from the nearest one [m]; ours."""
    margin: float = 1.0
    """How far beyond everything observed samples are drawn [m]; ours."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """Distances of viewpoints from a frontier; the first from which it can be seen is taken [m]; ours."""
    patience: int = 100
    """Control steps without a point that could be assigned after which exploration ends; ours."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "view_distances" and not value > 0:
                raise ValueError(f"{field.name} must be positive, got {value}")
        if not self.hysteresis_gain > 1:
            raise ValueError(f"hysteresis_gain must be greater than 1, got {self.hysteresis_gain}")
        if not self.view_distances or min(self.view_distances) < 0:
            raise ValueError(f"view_distances must hold distances of at least 0, got {self.view_distances}")
        if not min(self.eta_local, self.eta_global) >= self.spacing:
            raise ValueError(f"spacing must be at most eta_local and eta_global, got {self.spacing}")


TEAM_PARAMS = RrtParams(eta_global=1.0)
"""The launch file of the published program for three robots."""
