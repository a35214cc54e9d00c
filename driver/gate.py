"""Plausible numbers of messages."""

import math
import reprlib
from numbers import Real
from typing import Any

import numpy as np

from lidarnaut.envs.localization.amcl import check_covariance

POSE = {"x": (2e7, "m"), "y": (2e7, "m"), "theta": (1e6, "rad")}
STAMP = {"stamp": (2.0**33, "s")}
KINDS: dict[str, dict[str, tuple[float, str]]] = {
    "odometry": POSE,
    "encoders": {"left": (2.0**53, "counts"), "right": (2.0**53, "counts")},
    "imu": {"yaw rate": (100.0, "rad/s")},
    "goal": POSE,
    "initial pose": POSE,
    "velocity command": {"speed": (100.0, "m/s"), "yaw rate": (100.0, "rad/s")},
}
"""Numbers of a message by kind, each with the limit of its magnitude and the unit. Northings of UTM reach 1e7 m; stamps
of ROS, 2^32 s; headings may count turns."""
MAX_VARIANCES = np.array([100.0, 100.0, math.pi**2])
"""Largest variances of an initial pose: standard deviations of 10 m and half a turn [m2, m2, rad2]."""


class ImplausibleError(ValueError):
    """A number of a message is not finite, or beyond its limit; the text does not repeat the number."""


def check_numbers(kind: str, numbers: Any, limits: dict[str, tuple[float, str]] | None = None) -> tuple[float, ...]:
    """Return the numbers of a message as floats. `limits`: default: those of `KINDS`.

    Raises:
        ImplausibleError: a number is not finite, or not below its limit.
        ValueError: not as many numbers as there are limits, or no real numbers.
    """
    limits, given = limits or KINDS[kind], np.array(numbers, dtype=object)
    if given.shape != (len(limits),) or not all(isinstance(each, Real) and each is not True for each in given):
        text = f"{kind} must be {len(limits)} numbers, got {reprlib.repr(numbers)}"
        raise ValueError(f"{text}; needed: {', '.join(limits)}")
    for value, (name, (limit, unit)) in zip(given, limits.items(), strict=True):
        if not -math.inf < value < math.inf:
            raise ImplausibleError(f"{kind} that is not finite")
        if not -limit < value < limit:
            raise ImplausibleError(f"{kind} with {name} beyond {limit:g} {unit}")
    return tuple(map(float, given))


def check_array(kind: str, values: Any, dtype: Any) -> np.ndarray:
    """Return numbers of a message as a new array, infinite beyond `dtype`; ValueError if they are no real numbers."""
    try:
        given = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{kind} must be numbers: {error}") from error
    if given.dtype.kind not in "iuf":
        raise ValueError(f"{kind} must be numbers, got {reprlib.repr(values)}")
    with np.errstate(over="ignore"):
        return given.astype(dtype)


def pose_covariance(numbers: Any) -> np.ndarray | None:
    """Return the covariance of x, y and heading, shape (3, 3), float64 [m, m, rad]; None if it is None or zero.

    `numbers`: as many, or 36 of a `PoseWithCovariance`. ValueError if they are no covariance, or above `MAX_VARIANCES`.
    """
    given = check_array("covariance", np.zeros((3, 3)) if numbers is None else numbers, np.float64)
    if given.size == 36:
        given = given.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    if given.shape == (3, 3) and not (np.diag(given) <= MAX_VARIANCES).all():
        raise ValueError(f"covariance has variances {np.diag(given)}; at most {MAX_VARIANCES} m2, m2, rad2 are allowed")
    return check_covariance(given) if given.any() else None
