"""Domain randomization of robot parameters."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from lidarnaut.envs.files import explain_errors
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Mover

_RECORDS = {
    "body": ("friction", "mass"),
    "drive": ("friction", "max_torque", "slip_std", "track", "wheel_radius"),
    "imu": ("compass_deviation", "compass_offset", "compass_std", "gyro_bias_std", "gyro_std"),
    "lidar": ("dropout", "mount.pitch", "mount.roll", "mount.x", "mount.y", "mount.yaw", "noise_std"),
}
RANDOMIZABLE = (
    *(f"{record}.{name}" for record, names in _RECORDS.items() for name in names),
    *("max_acc_v", "max_acc_w", "max_v", "max_w"),
)
"""Names of the robot parameters that may be randomized. Parameters that affect spaces, maps or plans may not, such as
footprint and lidar range."""
AT_MOST_NOMINAL = ("max_v", "max_w")
"""Names of robot parameters whose samples must not exceed the nominal value, as commands use the nominal limits."""

Ranges = Mapping[str, Sequence[float]]
"""Ranges (low, high) by parameter name, in the unit of the parameter."""


class Randomization:
    """Samples robot parameters uniformly from ranges in each episode."""

    def __init__(self, ranges: Ranges, robot: RobotParams, mover: Mover) -> None:
        """Check the ranges for a nominal robot and its mover, which then has the highest values.

        Raises:
            ValueError: if a name or a range is not allowed.
        """
        if not isinstance(ranges, Mapping):
            raise ValueError(f"randomize must map names of parameters to (low, high), got {ranges!r}")
        ignored = mover.ignored
        if not robot.imu.has_compass:
            ignored = (*ignored, *(name for name in RANDOMIZABLE if name.startswith("imu.compass")))
        allowed = [name for name in RANDOMIZABLE if name not in ignored]
        if unknown := sorted(map(str, set(ranges) - set(allowed))):
            fault = f"names {unknown} that are unknown or have no effect here"
            raise ValueError(f"randomize has {fault}; allowed are {allowed}")
        self._robot = robot
        self._ranges = {name: _check_range(name, ranges[name], robot) for name in sorted(ranges)}
        mover.set_robot(self.robot({name: high for name, (_, high) in self._ranges.items()}))

    def draw(self, rng: np.random.Generator) -> RobotParams:
        """Sample `values`, and return the robot with them."""
        self.values = {name: float(rng.uniform(low, high)) for name, (low, high) in self._ranges.items()}
        return self.robot(self.values)

    def robot(self, values: Mapping[str, float]) -> RobotParams:
        robot = self._robot
        for name, value in values.items():
            robot = _replace_nested(robot, name, value)
        return robot


def _check_range(name: str, value: Any, robot: RobotParams) -> tuple[float, float]:
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        raise ValueError(f"randomize[{name!r}] must be two numbers (low, high), got {value!r}") from None
    if not -math.inf < low <= high < math.inf:
        raise ValueError(f"randomize[{name!r}] must be finite and have low <= high, got {value!r}")
    if name in AT_MOST_NOMINAL and high > getattr(robot, name):
        raise ValueError(f"randomize[{name!r}] must not exceed the robot's {getattr(robot, name)}, got {value!r}")
    for end in (low, high):
        try:
            _replace_nested(robot, name, end)
        except ValidationError as error:
            raise ValueError(f"randomize[{name!r}]: {'; '.join(explain_errors(error, RobotParams))}") from None
    return low, high


def _replace_nested(record: Any, name: str, value: float) -> Any:
    first, _, rest = name.partition(".")
    return replace(record, **{first: _replace_nested(getattr(record, first), rest, value) if rest else value})
