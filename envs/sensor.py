"""Interface of user-defined sensors."""

import copy
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.files import resolve
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Simulator
from lidarnaut.envs.worlds import World

SENSOR_MEMBERS = ("name", "shape", "reset", "measure")


class Sensor(Protocol):
    """Interface of user-defined sensors, which measure ground truth with noise."""

    name: str
    """Key of measurements in `reading.extra`, and name of the observation with the measurement."""
    shape: tuple[int, ...]
    """Shape of a measurement."""

    def reset(self, world: World, rng: np.random.Generator) -> None:
        """Start an episode in a world; draw noise from `rng`."""
        ...

    def measure(self, simulator: Simulator, robot: int) -> np.ndarray:
        """Return the measurement of the robot with index `robot`; called once per robot and control period."""
        ...


class Measured:
    """Observation with the last measurement of a user-defined sensor."""

    def __init__(self, sensor: Sensor) -> None:
        self._name, self._shape = sensor.name, tuple(sensor.shape)

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, self._shape, np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        out[...] = robot.reading.extra[self._name]


def measure_all(sensors: Sequence[Sensor], simulator: Simulator, robot: int) -> dict[str, np.ndarray]:
    """Return the measurements of a robot by the names of the sensors."""
    return {sensor.name: sensor.measure(simulator, robot) for sensor in sensors}


def reset_sensors(
    sensors: Sequence[Sensor], simulator: Simulator, world: World, rngs: Sequence[Any], readings: Sequence[Reading]
) -> Sequence[Reading]:
    """Start an episode of sensors, with a generator each; return the readings of all robots with measurements."""
    for sensor, rng in zip(sensors, rngs, strict=True):
        sensor.reset(world, rng)
    if not sensors:
        return readings
    return [one._replace(extra=measure_all(sensors, simulator, k)) for k, one in enumerate(readings)]


def make_sensors(sensors: Sequence[Any]) -> list[Sensor]:
    """Create sensors from `Sensor` objects (copied), `Sensor` classes, or import paths `module:attribute`.

    Raises:
        ValueError: if an item is not a sensor, or two sensors have the same name.
    """
    if isinstance(sensors, str) or not isinstance(sensors, Sequence):
        raise ValueError(f"sensors must be a sequence of sensors or module:attribute, got {sensors!r}")
    made: list[Sensor] = []
    for item in sensors:
        found = resolve(item, {}, "sensor")
        sensor = found() if isinstance(found, type) else copy.deepcopy(found)
        if missing := [name for name in SENSOR_MEMBERS if not hasattr(sensor, name)]:
            raise ValueError(f"sensor {item!r} lacks {', '.join(missing)}; see lidarnaut.envs.sensor.Sensor")
        made.append(sensor)
    names = [sensor.name for sensor in made]
    if len(set(names)) < len(names):
        raise ValueError(f"sensors must have unique names, got {names}")
    return made
