"""Plausible numbers of messages."""

import math
from numbers import Real
from typing import Any

import numpy as np

POSE = {"x": (2e7, "m"), "y": (2e7, "m"), "theta": (1e6, "rad")}
KINDS: dict[str, dict[str, tuple[float, str]]] = {
    "odometry": POSE,
    "encoders": {"left": (2.0**53, "counts"), "right": (2.0**53, "counts")},
    "imu": {"yaw rate": (100.0, "rad/s")},
    "goal": POSE,
    "initial pose": POSE,
    "velocity command": {"speed": (1000.0, "m/s"), "yaw rate": (1000.0, "rad/s")},
    "stamp": {"time": (2.0**33, "s")},
}
"""Numbers of a message by kind, each with the limit of its magnitude and the unit. Northings of UTM reach 1e7 m; stamps
of ROS, 2^32 s; headings may count turns."""


class ImplausibleError(ValueError):
    """A number of a message is not finite, or beyond its limit."""


def check_numbers(kind: str, numbers: Any) -> tuple[float, ...]:
    """Return the numbers of a message of one of `KINDS` as floats.

    Raises:
        ImplausibleError: a number is not finite, or not below its limit. The text does not repeat the number.
        ValueError: not as many numbers as the kind has, or no real numbers.
    """
    limits, given = KINDS[kind], np.array(numbers, dtype=object)
    if given.shape != (len(limits),) or not all(isinstance(each, Real) and each is not True for each in given):
        raise ValueError(f"{kind} must be {len(limits)} numbers ({', '.join(limits)}), got {numbers!r}")
    checked = []
    for value, (name, (limit, unit)) in zip(given, limits.items(), strict=True):
        try:
            checked.append(float(value))
        except OverflowError:  # an integer
            checked.append(math.inf)
        if not math.isfinite(checked[-1]):
            raise ImplausibleError(f"{kind} that is not finite")
        if not abs(checked[-1]) < limit:
            raise ImplausibleError(f"{kind} with {name} beyond {limit:g} {unit}")
    return tuple(checked)
