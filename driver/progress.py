"""State of a drive in lines for people, and its end."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.command_line import plus_minus

from .driver import Driver
from .rosbridge import without_numbers

LOGGER = logging.getLogger(__name__)
REPORT_PERIOD = 10.0
"""Time between lines about the state [s]."""
MAX_STEP = 10.0
"""Longer steps of the clock are jumps [s]."""
SETTLED = 5.0
"""A policy that finds nothing more to do for this time is done [s]."""


class Progress:
    """What a drive has done, by times of the robot's clock."""

    def __init__(self, goal: Sequence[float] | None) -> None:
        """Begin. `goal`: x, y [m] and optionally heading, map frame; reaching it ends the drive."""
        self._goal, self._said = goal, "not asked yet"
        self.elapsed, self._now = 0.0, math.nan
        """Time since the first scan was used, without jumps of the clock [s]."""
        self._busy, self._reported, self._was_localized = 0.0, -math.inf, False

    def is_done(self, driver: Driver) -> bool:
        """Return whether the goal is reached, or an explorer has found nothing more to do for a while."""
        goal = driver.env.task.goal
        if goal is None:
            return self.elapsed - self._busy >= SETTLED
        return driver.reason == "reached" and self._goal is not None and goal[:2] == tuple(self._goal[:2])

    def note(self, driver: Driver, now: float) -> None:
        """Note a command; say when and why the robot stops, and each `REPORT_PERIOD` what is known."""
        kind = without_numbers(driver.reason.partition(" for ")[0])
        if kind != self._said:
            self._said = kind
            LOGGER.info("stopped: %s" if kind else "driving%s", driver.reason)
        if not driver.has_begun:
            return
        step, self._now = now - self._now, now
        self.elapsed += step if 0.0 < step < MAX_STEP else 0.0
        if not driver.reason or driver.reason != driver.end_reason:
            self._busy = self.elapsed
        self._was_localized |= not driver.belief.is_lost
        if self.elapsed - self._reported < REPORT_PERIOD:
            return
        self._reported, belief, goal = self.elapsed, driver.belief, driver.env.task.goal
        area = np.count_nonzero(belief.grid.data >= 0) * belief.grid.resolution**2
        parts = [f"map {area:.1f} m2"]
        if belief.is_lost:  # pose, uncertainty and distance are those of one of several hypotheses
            many = f" ({len(belief.hypotheses)} hypotheses)" if len(belief.rivals) else ""
            parts.append(("lost" if self._was_localized else "not localized yet") + many)
        else:
            parts.append("at {:.2f} {:.2f} m, {:.2f} rad".format(*belief.pose))
            if (variance := float(np.trace(belief.covariance[:2, :2]))) > 0.0:
                parts.append(f"{plus_minus(math.sqrt(variance), 2)} m")
            if goal is not None and driver.env.task.has_goal:
                parts.append(f"{math.dist(belief.pose[:2], goal[:2]):.1f} m to the goal {goal[0]:g} {goal[1]:g}")
        parts += [f"{count} dropped: {reason}" for reason, count in driver.dropped.items()]
        LOGGER.info("%s", ", ".join(parts))
