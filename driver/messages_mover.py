"""Measurements of a real robot in the place of a simulation."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation import Mover, Reading
from lidarnaut.envs.simulation.odometry import update_odometry
from lidarnaut.envs.worlds import World

RESOLUTION = 1e-6
"""Stamps are rounded; durations that differ by less from the control period are equal to it [s]."""


class Sample(NamedTuple):
    """Measurements at one time.

    `time` since the first sample [s]; `ranges` as in `Reading`; `ticks`: cumulative encoder counts, left and right;
    `yaw_rate`: mean one since the last sample [rad/s]; `bumper`: whether the body touched anything since then.
    """

    time: float
    ranges: np.ndarray
    ticks: tuple[int, int]
    yaw_rate: float
    bumper: bool


class MessagesMover(Mover):
    """Mover of a real robot, which moves by itself: `move` takes over the last sample."""

    ignores = MappingProxyType(dict.fromkeys(("world", "start", "people", "reward", "randomize"), "an environment"))
    sample: Sample

    def reset(
        self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator], crowd_rng: Any = None
    ) -> list[Reading]:
        self.rngs = rngs
        self.rows.reset()
        self._take(0)
        return self._readings()

    def move(self) -> None:
        self._take(self.rows.steps + 1)

    def _take(self, steps: int) -> None:
        row, sample = self.rows.numbers[0], self.sample
        row["yaw_rate"], row["heading"], row["touched"] = sample.yaw_rate, np.nan, sample.bumper
        elapsed = sample.time - row["time"]
        if steps:
            row["period"] = self._period if abs(elapsed - self._period) < RESOLUTION else elapsed
        row["steps"], row["time"] = steps, sample.time
        update_odometry(row, *sample.ticks)
        self.rows.ranges[0] = sample.ranges
