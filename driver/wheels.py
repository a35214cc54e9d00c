"""Motion of the wheels, from messages of odometry or encoders."""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.logs.trajectory import between_poses, interpolate_poses
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation.odometry import wheel_motion

MOST_MESSAGES = 4096
"""Maximum number of kept messages."""
MAX_SPEED, JITTER = 1.5, 0.05
"""Odometry that moves faster than this multiple of the robot's limits, for longer than this time [s], has jumped."""
PUSHED = 1.0, 3.0
"""Least limits of that test: speeds of a robot that is pushed by hand [m/s, rad/s]."""


class WheelMotion:
    """Encoder counts of the wheels, or of virtual encoders that follow odometry; at jumps, turns of the gyroscope."""

    def __init__(self, robot: RobotParams, scales: tuple[float, float], *, uses_encoders: bool) -> None:
        """Begin without messages. `scales`: factors of distances and turns."""
        self._robot, self._scales, self.uses_encoders = robot, scales, uses_encoders
        self.messages: deque[tuple[float, np.ndarray]] = deque(maxlen=MOST_MESSAGES)
        """Stamp [s], and base pose in the odometry frame or encoder counts, of each message, oldest first."""
        self._newest = np.zeros(3)  # content of the newest message at the last `advance`
        self.ticks = 0, 0
        """Encoder counts of the left and the right wheel since the first `advance`, without jumps."""
        self._travel = np.zeros(2)  # of the wheels [m]

    @property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([time for time, _ in self.messages]), np.array([each for _, each in self.messages])

    @property
    def pose(self) -> Pose2D:
        """Base pose at the last `advance`, odometry frame; the origin with encoders."""
        return ORIGIN if self.uses_encoders else Pose2D(*self._newest.tolist())

    def poses(self, stamps: np.ndarray) -> np.ndarray:
        """Return the base poses at some stamps [s], shape (n, 3) [m, m, rad], all in the same frame."""
        times, content = self._arrays
        if not self.uses_encoders:
            return interpolate_poses(times, content, stamps)
        numbers = self._robot.odometry.metres_per_tick, self._robot.odometry.track
        counts = np.column_stack([np.interp(stamps, times, column) for column in (content - content[-1]).T])
        return np.array([wheel_motion(left, right, *numbers) for left, right in counts])

    def advance(self, last: float, longest: float, rates: Sequence[tuple[float, np.ndarray]], *, is_first: bool) -> int:
        """Update `ticks` and `pose` to the newest message, and return the number of ignored jumps.

        `last`: stamp of the last call, -inf after a step of the clock. `longest`: longest assumed pause before the
        messages since then [s]. `rates`: stamps and yaw rates of the gyroscope [s, rad/s]. `is_first`: whether the
        robot has not moved before.
        """
        times, content = self._arrays
        is_new = times > last
        path = content[-1:] if is_first else np.vstack([self._newest, content[is_new]])
        durations = np.diff(times[is_new], prepend=max(last, times[is_new][0] - longest))[: len(path) - 1]
        self._newest = content[-1]
        metres, track = self._robot.odometry.metres_per_tick, self._robot.odometry.track
        if self.uses_encoders:
            lefts, rights = np.diff(path, axis=0).T * metres
            lengths, turns = 0.5 * (lefts + rights), (rights - lefts) / track
        else:
            steps = between_poses(path[:-1], path[1:])
            half, turns = 0.5 * steps[:, 2], steps[:, 2]
            lengths = (steps[:, 0] * np.cos(half) + steps[:, 1] * np.sin(half)) / np.sinc(half / math.pi)
        max_v, max_w = MAX_SPEED * np.maximum(PUSHED, (self._robot.max_v, self._robot.max_w))
        has_jumped = (abs(lengths) > max_v * (durations + JITTER)) | (abs(turns) > max_w * (durations + JITTER))
        lengths, turns = np.where(has_jumped, 0.0, [self._scales[0] * lengths, self._scales[1] * turns])
        if has_jumped.any() and rates:
            stamps, sums = [time for time, _ in rates], np.cumsum([0.0, *(rate.item() for _, rate in rates)])
            first, end = np.searchsorted(stamps, times[is_new] - [durations, np.zeros_like(durations)], side="right")
            means = (sums[end] - sums[first]) / np.maximum(end - first, 1)
            turns = np.where(has_jumped, durations * np.clip(means, -max_w, max_w), turns)
        sides = 0.5 * track * turns
        self._travel += (lengths - sides).sum(), (lengths + sides).sum()
        left, right = np.rint(self._travel / metres).astype(int).tolist()
        self.ticks = left, right
        return int(has_jumped.sum())
