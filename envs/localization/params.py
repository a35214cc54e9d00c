"""Parameters of AMCL, and their presets."""

import math
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files import resolve
from lidarnaut.envs.robots.params import CONFIG, NotNegative, Positive

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
SensorModel = Literal["likelihood_field", "likelihood_field_prob", "beam"]


@dataclass(frozen=True, slots=True, kw_only=True, config=CONFIG)
class AmclParams:
    """Parameters of AMCL. Defaults are Nav2's, with its names where they do not mislead."""

    min_particles: Count = 500
    """Least number of particles."""
    max_particles: int = 2000
    """Greatest number of particles, and the number to start with around an initial pose."""
    global_particles: int | None = None
    """Particles to start global localization with; None for `max_particles`. From the first used scan on there are at
    most `max_particles`."""
    kld_err: Positive = 0.05
    """Bound of the Kullback-Leibler divergence between the particles and the true distribution; Nav2's `pf_err`."""
    kld_z: Positive = 0.99
    """Upper quantile of the standard normal with which the bound holds; Nav2's `pf_z`, a quantile there too."""
    bin_size: Positive = 0.5
    """Side of the histogram bins of KLD-sampling and clustering [m]."""
    bin_angle: Annotated[float, Field(gt=0.0, le=math.pi)] = math.radians(10.0)
    """Size of the bins in heading [rad]; rounded so that a whole number fills the turn."""
    alpha1: NotNegative = 0.2
    """Variance of a rotation per squared rotation."""
    alpha2: NotNegative = 0.2
    """Variance of a rotation per squared translation [rad2/m2]."""
    alpha3: NotNegative = 0.2
    """Variance of a translation per squared translation."""
    alpha4: NotNegative = 0.2
    """Variance of a translation per squared rotation [m2/rad2]."""
    sensor: SensorModel = "likelihood_field"
    """Sensor model; see `docs/localization.md`."""
    max_beams: Count = 60
    """Beams of a scan that are used, evenly spread."""
    max_range: Positive | None = None
    """Readings from this on count as no return [m]; None takes the lidar's range."""
    z_hit: NotNegative = 0.5
    """Weight of readings at an obstacle of the map."""
    z_short: NotNegative = 0.05
    """Weight of readings in front of it (`beam`)."""
    z_max: NotNegative = 0.05
    """Weight of readings without a return (`beam`)."""
    z_rand: Positive = 0.5
    """Weight of random readings."""
    sigma_hit: Positive = 0.2
    """Standard deviation of readings around the obstacle [m]."""
    lambda_short: NotNegative = 0.1
    """Rate at which readings before the obstacle become rarer with their range [1/m] (`beam`)."""
    max_distance: Positive = 2.0
    """Upper limit of the distance to the nearest obstacle [m]; Nav2's `laser_likelihood_max_dist`."""
    squash: Positive = 1.0
    """Divisor of a scan's log likelihood, because beams are not as independent as `likelihood_field_prob`, which alone
    uses it, assumes; 1 in Nav2, 2.2 in MIT's filter for race cars."""
    update_min_d: NotNegative = 0.25
    """A scan is used once the robot is this far from where the last one was used [m]..."""
    update_min_a: NotNegative = 0.2
    """... or has turned by this much since [rad]."""
    resample_interval: Count = 1
    """Number of used scans per resampling."""
    alpha_slow: Share = 0.0
    """Rate of the long-term average of the likelihood; 0 for no injection of random particles."""
    alpha_fast: Share = 0.0
    """Rate of the short-term average of the likelihood."""
    initial_std: NotNegative = 0.5
    """Standard deviation of the initial position, per axis [m]."""
    initial_std_theta: NotNegative = math.radians(15.0)
    """Standard deviation of the initial heading [rad]."""
    lost_distance: NotNegative = 0.2
    """The map explains hits within this distance of an obstacle [m]."""
    lost_fit: Share = 0.5
    """The filter is lost where the map explains less than this share of the hits of recent scans."""
    lost_updates: Count = 5
    """Number of used scans that count as recent. After global localization so many must fit before the pose counts, and
    no other pose may fit them as well."""
    lost_spread: Positive = 0.5
    """The filter is lost while the heaviest cluster's positions deviate by more than this from their mean (root mean
    square) [m], or while that cluster holds less than half of the weight."""
    relocalize: bool = False
    """Whether global localization starts anew once the map has not explained `lost_updates` used scans. It always does
    once all particles have left the free space."""

    def __post_init__(self) -> None:
        for name in ("max_particles", "global_particles"):
            count = getattr(self, name)
            if count is not None and count < self.min_particles:
                raise ValueError(f"{name} must be at least min_particles, got {count}")
        if self.alpha_slow > self.alpha_fast:
            raise ValueError(f"alpha_slow must not exceed alpha_fast, got {self.alpha_slow}")

    @property
    def most_particles(self) -> int:
        """Greatest number of particles at any time, with those of global localization."""
        return max(self.max_particles, self.global_particles or 0)


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
"""Parameters by name: `nav2` are Nav2's defaults, `turtlebot3` those of TurtleBot3's launch file for AMCL, which Nguyen
et al., "SLAM for mobile robots" (2022), drive their robot with, and `default` those of the environments."""


def load_preset(preset: str | AmclParams) -> AmclParams:
    """Return parameters by the name of a preset, by `module:attribute`, or as they are.

    Raises:
        ValueError: for an unknown name.
    """
    return resolve(preset, PRESETS, "AMCL preset")
