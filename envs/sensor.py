"""Sensors of the user's own, beside lidar, wheels, gyroscope, compass and bumper."""

import copy
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.files import resolve
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.worlds import World

MEMBERS = ("name", "shape", "reset", "measure")
"""What a sensor has."""


class Sensor(Protocol):
    """Measures what is true in the simulation, with noise of its own; readings hold it as `reading.extra[name]`."""

    name: str
    """Key in `reading.extra`, and the name of the observation part that shows it as it is."""
    shape: tuple[int, ...]
    """Shape of what it measures."""

    def reset(self, world: World, rng: np.random.Generator) -> None:
        """Start an episode in a world; noise is to be drawn from `rng`."""
        ...

    def measure(self, simulator: Simulator, robot: int) -> np.ndarray:
        """Return what one of the robots measures now, an array of `shape`; called once in a control period for each."""
        ...


class Measured:
    """Observation part that shows what a sensor measured, as float32 without bounds."""

    def __init__(self, sensor: Sensor) -> None:
        self._name, self._shape = sensor.name, tuple(sensor.shape)

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-inf, inf, shape, float32)`."""
        return spaces.Box(-np.inf, np.inf, self._shape, np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the last measurement to `out`."""
        out[...] = robot.reading.extra[self._name]


def make_sensors(sensors: Sequence[Any]) -> list[Sensor]:
    """Return sensors from objects, which are copied, classes, or `module:attribute` of either.

    Raises:
        ValueError: one is no sensor, or two have the same name.
    """
    if isinstance(sensors, str) or not isinstance(sensors, Sequence):
        raise ValueError(f"sensors must be a sequence of sensors or module:attribute, got {sensors!r}")
    made: list[Sensor] = []
    for given in sensors:
        found = resolve(given, {}, "sensor")
        sensor = found() if isinstance(found, type) else copy.deepcopy(found)
        if missing := [name for name in MEMBERS if not hasattr(sensor, name)]:
            raise ValueError(f"sensor {given!r} lacks {', '.join(missing)}; see lidarnaut.envs.sensor.Sensor")
        made.append(sensor)
    names = [sensor.name for sensor in made]
    if len(set(names)) < len(names):
        raise ValueError(f"sensors must have names of their own, got {names}")
    return made
