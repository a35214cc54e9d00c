"""Parameters and presets of AMCL."""

from dataclasses import replace
from typing import Literal

from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import resolve
from lidarnaut.envs.robots.robot_params import CONFIG, Count, NotNegative, Positive, Share


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class AmclParams:
    """Parameters of AMCL. Defaults are Nav2's."""

    min_particles: Count = 500
    """Minimum number of particles."""
    max_particles: int = 2000
    """Maximum number of particles. Also the initial number if the start pose is known."""
    global_particles: int | None = None
    """Initial number of particles for global localization; None for `max_particles`."""
    kld_err: Positive = 0.05
    """Maximum Kullback-Leibler divergence in KLD-sampling (Nav2: `pf_err`)."""
    kld_z: Positive = 0.99
    """Standard normal quantile in KLD-sampling (Nav2: `pf_z`)."""
    alpha1: NotNegative = 0.2
    """Odometry noise: rotation variance per squared rotation [rad2/rad2]."""
    alpha2: NotNegative = 0.2
    """Odometry noise: rotation variance per squared translation [rad2/m2]."""
    alpha3: NotNegative = 0.2
    """Odometry noise: translation variance per squared translation [m2/m2]."""
    alpha4: NotNegative = 0.2
    """Odometry noise: translation variance per squared rotation [m2/rad2]."""
    sensor: Literal["likelihood_field", "likelihood_field_prob", "beam"] = "likelihood_field"
    """Sensor model that weights particles: `likelihood_field`, `likelihood_field_prob` or `beam`."""
    max_beams: Count = 60
    """Maximum number of beams used per scan, evenly spaced."""
    max_range: Positive | None = None
    """Readings of at least this range count as no return [m]; None for the lidar's maximum range."""
    z_hit: NotNegative = 0.5
    """Mixture weight of hits on mapped obstacles."""
    z_short: NotNegative = 0.05
    """Mixture weight of short readings (sensor model `beam`)."""
    z_max: NotNegative = 0.05
    """Mixture weight of maximum-range readings (sensor model `beam`)."""
    z_rand: Positive = 0.5
    """Mixture weight of random readings."""
    sigma_hit: Positive = 0.2
    """Standard deviation of hits around mapped obstacles [m]."""
    lambda_short: NotNegative = 0.1
    """Exponential decay rate of short readings [1/m] (sensor model `beam`)."""
    max_distance: Positive = 2.0
    """Maximum obstacle distance in the likelihood field [m]; Nav2's `laser_likelihood_max_dist`."""
    squash: Positive = 1.0
    """Divisor of a scan's log-likelihood, as beams are not independent (sensor model `likelihood_field_prob`); 1 in
    Nav2."""
    update_min_d: NotNegative = 0.25
    """Travel that triggers a particle update by a scan [m]."""
    update_min_a: NotNegative = 0.2
    """Rotation that triggers a particle update by a scan [rad]."""
    resample_interval: Count = 1
    """Number of particle updates per resampling."""
    alpha_slow: Share = 0.0
    """Decay rate per update of the long-term average likelihood; 0 disables random particle injection."""
    alpha_fast: Share = 0.0
    """Decay rate per update of the short-term average likelihood."""
    lost_distance: NotNegative = 0.2
    """Beam end points up to this distance from a mapped obstacle fit the map [m]."""
    lost_fit: Share = 0.5
    """Minimum share of beam end points of recent scans that fit the map. Below this share, the robot is lost, or, with
    `relocalize`, searched for elsewhere."""
    lost_updates: Count = 5
    """Number of recent scans over which the fit to the map is averaged. Global localization takes at least as many
    scans."""
    relocalize: bool = False
    """Whether to search for another pose if recent scans do not fit the map. A tracked pose is given up only for a pose
    that explains them clearly better. If no particle is in free space, global localization always restarts."""

    def __post_init__(self) -> None:
        for name in ("max_particles", "global_particles"):
            count = getattr(self, name)
            if count is not None and count < self.min_particles:
                raise ValueError(f"{name} must be at least min_particles, got {count}")
        if self.alpha_slow > self.alpha_fast:
            raise ValueError(f"alpha_slow must not exceed alpha_fast, got {self.alpha_slow}")


PRESETS: dict[str, AmclParams] = {
    "nav2": AmclParams(),
    "default": AmclParams(
        max_particles=5000,
        global_particles=100_000,
        alpha1=0.05,
        alpha2=0.05,
        alpha3=0.05,
        alpha4=0.05,
        sensor="likelihood_field_prob",
        sigma_hit=0.1,
        squash=4.0,
        update_min_d=0.1,
        update_min_a=0.1,
        lost_fit=0.8,
        lost_updates=10,
        relocalize=True,
    ),
    "turtlebot3": AmclParams(
        max_particles=3000,
        kld_err=0.02,
        alpha1=0.1,
        alpha2=0.1,
        alpha3=0.1,
        alpha4=0.1,
        max_beams=180,
        max_range=3.5,
        update_min_d=0.2,
    ),
}
"""AMCL parameters by preset name: `nav2` (Nav2's defaults), `turtlebot3` (launch file, as in Nguyen et al., "SLAM for
mobile robots", 2022), `default` (of the environments), `slam_map` (for maps made by SLAM, which fit scans less)."""
PRESETS["slam_map"] = replace(PRESETS["default"], lost_fit=0.7)


def load_preset(preset: str | AmclParams) -> AmclParams:
    """Return AMCL parameters by preset name or `module:attribute`; ValueError for unknown names."""
    return resolve(preset, PRESETS, "AMCL preset")
