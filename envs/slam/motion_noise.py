"""How far odometry may be off after a motion."""

from typing import NamedTuple, Self

from numba import njit

from envs.robots import OdometryNoise


class NoiseRecord(NamedTuple):
    """`OdometryNoise` as kernels take it."""

    position_std: float
    position_per_metre: float
    heading_std: float
    heading_per_radian: float
    heading_per_metre: float

    @classmethod
    def of(cls, noise: OdometryNoise) -> Self:
        """Return the same numbers."""
        return cls(*(float(getattr(noise, field)) for field in cls._fields))


@njit(cache=True, error_model="numpy")
def motion_stds(noise, travelled, turn):
    """Return the standard deviations of position [m] and heading [rad] after a motion; see `OdometryNoise`.

    Args:
        noise: `NoiseRecord`.
        travelled: distance [m].
        turn: change of heading [rad].
    """
    heading_std = noise.heading_std + noise.heading_per_radian * abs(turn) + noise.heading_per_metre * travelled
    return noise.position_std + noise.position_per_metre * travelled, heading_std
