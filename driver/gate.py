"""Plausible numbers of messages."""

import math
import reprlib
from numbers import Real
from typing import Any

import numpy as np

from lidarnaut.envs.localization.amcl import check_covariance

Limits = dict[str, tuple[float, str]]
"""Numbers of a message by name, each with the limit of its magnitude and the unit."""
POSE: Limits = {"x": (2e7, "m"), "y": (2e7, "m"), "theta": (1e6, "rad")}
"""Northings of UTM reach 1e7 m; headings may count turns."""
STAMP: Limits = {"stamp": (2.0**33, "s")}
"""Stamps of ROS reach 2^32 s."""
KINDS: dict[str, Limits] = {
    "odometry": POSE,
    "encoders": {"left": (2.0**53, "counts"), "right": (2.0**53, "counts")},
    "imu": {"yaw rate": (100.0, "rad/s")},
    "goal": POSE,
    "initial pose": POSE,
    "velocity command": {"speed": (1000.0, "m/s"), "yaw rate": (1000.0, "rad/s")},
}
"""Limits by kind of message."""
MAX_VARIANCES = np.array([100.0, 100.0, math.pi**2])
"""Largest variances of an initial pose: standard deviations of 10 m and of half a turn [m2, m2, rad2]."""


class ImplausibleError(ValueError):
    """A number of a message is not finite, or beyond its limit; the text does not repeat the number."""


def check_numbers(kind: str, numbers: Any, limits: Limits | None = None) -> tuple[float, ...]:
    """Return the numbers of a message as floats. `limits`: default: those of the kind in `KINDS`.

    Raises:
        ImplausibleError: a number is not finite, or not below its limit.
        ValueError: not as many numbers as there are limits, or no real numbers.
    """
    limits, given, checked = limits or KINDS[kind], np.array(numbers, dtype=object), []
    if given.shape != (len(limits),) or not all(isinstance(each, Real) and each is not True for each in given):
        text = f"{kind} must be {len(limits)} numbers, got {reprlib.repr(numbers)}"
        raise ValueError(f"{text}; needed: {', '.join(limits)}")
    for value, (name, (limit, unit)) in zip(given, limits.items(), strict=True):
        try:
            number = float(value)
        except OverflowError:  # of an integer
            number = math.inf
        if not math.isfinite(number):
            raise ImplausibleError(f"{kind} that is not finite")
        if not abs(number) < limit:
            raise ImplausibleError(f"{kind} with {name} beyond {limit:g} {unit}")
        checked.append(number)
    return tuple(checked)


def check_array(kind: str, values: Any, dtype: Any) -> np.ndarray:
    """Return numbers of a message as a new array of `dtype`; numbers beyond it are infinite.

    ValueError if they are no real numbers.
    """
    try:
        given = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{kind} must be numbers: {error}") from error
    if given.dtype.kind not in "iuf":
        raise ValueError(f"{kind} must be numbers, got {reprlib.repr(values)}")
    with np.errstate(over="ignore"):
        return given.astype(dtype)


def pose_covariance(numbers: Any) -> np.ndarray | None:
    """Return the covariance of a pose x, y, heading, shape (3, 3), float64 [m, m, rad].

    `numbers`: 36 numbers (row-major, x, y, z and rotations, as in `PoseWithCovariance`), or shape (3, 3); None if there
    are none, or only zeros. ValueError if they are no covariance, or a variance is above `MAX_VARIANCES`.
    """
    if numbers is None:
        return None
    given = check_array("covariance", numbers, np.float64)
    if given.size == 36:
        given = given.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    if given.shape == (3, 3) and not given.any():
        return None
    if given.shape == (3, 3) and not (np.diag(given) <= MAX_VARIANCES).all():
        raise ValueError(f"covariance has variances {np.diag(given)}; at most {MAX_VARIANCES} m2, m2, rad2 are allowed")
    return check_covariance(given)
