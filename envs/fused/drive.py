"""Drives of one robot, stepped by a kernel until the environment's or the navigator's objects are needed."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D
from envs.navigation import Navigator
from envs.navigation.navigator_kernels import check_progress, compute_velocity_command, update_obstacles
from envs.navigation.records import DRIVING
from envs.simulation.sensors import TOUCHED
from envs.simulation.state import X, Y

from .kernels import KEY_SCAN, REMEMBER, REMEMBER_TRUE, Shapes, step_rows
from .robots import FusedRobots

BLOCK = 16
"""Control periods for which noise is drawn at once."""
UNCHECKED = -1
"""Progress of a drive that has not been checked after the last control period."""


class Passed(NamedTuple):
    """Positions to remember of the control periods of a call."""

    estimated: np.ndarray
    """Shape (n, 2), float64, map frame [m]."""
    true: np.ndarray
    """Shape (n, 2), float64, world frame [m]."""
    counts: np.ndarray
    """Shape (3,), int64: how many there are of each, and periods that ended in contact, but for the last period."""


@njit(cache=True, error_model="numpy")
def drive(rows, shapes, setup, navigator, noise, passed, check_from):
    """Drive the first robot up to a key scan, until the noise is used up, or until its progress is to be judged.

    Args:
        rows: `Rows`, written.
        shapes: `Shapes`.
        setup: `Setup`.
        navigator: `NavigatorArrays`, written.
        noise: shape (n, k), float64, as `Sensors.draws`; a row is used for each control period.
        passed: `Passed`, written.
        check_from: control period of the drive from which on the navigator's objects check each one.

    Returns:
        Control periods, and the progress as `check_progress` returns it; `UNCHECKED` in the first two cases.
    """
    navigators, obstacles, constants = navigator.records, navigator.obstacles, navigator.numbers
    pose, twist, state, others = rows.pose[0], rows.twist[0], rows.states[0, 0], rows.others[0, 0]
    passed.counts[:] = 0
    no_points = obstacles[:0]
    num_rows = noise.shape[0]
    record = navigators[0]
    for k in range(num_rows):
        at = (pose[0], pose[1], pose[2])
        v, w = compute_velocity_command(navigators, navigator.path, obstacles, at, twist[0], constants)
        rows.commands[0, 0, 0], rows.commands[0, 0, 1] = v, w
        rows.draws[0, 0] = noise[k]
        step_rows(rows, shapes, setup)
        flags, touched = rows.flags[0], others[TOUCHED] > 0.0
        if flags & REMEMBER:
            _remember(passed.estimated, passed.counts, 0, pose[0], pose[1])
            rows.trail[0] = pose[:2]
        if flags & REMEMBER_TRUE:
            _remember(passed.true, passed.counts, 1, state[X], state[Y])
            rows.true_trail[0, 0], rows.true_trail[0, 1] = state[X], state[Y]
        motion = (rows.odometry[0, 0], rows.odometry[0, 1], rows.odometry[0, 2])
        sensors = (rows.ranges[0, 0], navigator.directions, touched)
        update_obstacles(navigators, obstacles, sensors, motion, no_points, constants)
        if flags & KEY_SCAN or k == num_rows - 1:
            return k + 1, UNCHECKED
        progress = check_progress(navigators, obstacles, (pose[0], pose[1], pose[2]), touched, constants)
        if progress != DRIVING or record.steps >= check_from:
            return k + 1, progress
        passed.counts[2] += touched
    return 0, UNCHECKED


@njit(cache=True, error_model="numpy")
def _remember(positions, counts, kind, x, y):
    positions[counts[kind], 0], positions[counts[kind], 1] = x, y
    counts[kind] += 1


class FusedDrive:
    """Drives the robot of a fusible environment by its navigator; see `drive`."""

    def __init__(self, env: Any, navigator: Navigator) -> None:
        """Take an environment for which `is_fusible` is true."""
        self._env, self._navigator = env, navigator
        self._robots = robots = FusedRobots([env])
        self._noise = np.empty((BLOCK, *robots.rows.draws[0, 0].shape))
        self._next = BLOCK
        self._passed = Passed(np.empty((BLOCK, 2)), np.empty((BLOCK, 2)), np.zeros(3, dtype=np.int64))

    def begin(self) -> None:
        """Begin an episode."""
        self._next = BLOCK

    def load(self) -> None:
        """Take over from the environment's objects."""
        env, robots = self._env, self._robots
        robots.load(0)
        circles = np.array(env.simulator.circles)
        self._shapes = Shapes((np.array(env.world.segments),), (circles,), (circles,))

    def advance(self, check_from: float) -> tuple[int, int, int, bool]:
        """Drive for one or more control periods, and bring all objects up to date.

        The task processes the last one; those before it gained nothing.

        Args:
            check_from: see `drive`.

        Returns:
            Control periods; how many of them but for the last ended in contact; progress, see `drive`; and whether the
            map has changed.
        """
        env, robots, navigator = self._env, self._robots, self._navigator
        rows, robot, truth, passed = robots.rows, env.robots[0], env.truths[0], self._passed
        count, progress = drive(
            rows,
            self._shapes,
            robots.setup,
            navigator.arrays,
            self._next_noise(),
            passed,
            min(check_from, 1 << 40),
        )
        self._next += count
        robots.steps[0] += count
        v, w = rows.commands[0, 0].tolist()
        robots.actions[0] = v / robot.params.max_v, w / robot.params.max_w
        robots.sync(0)
        navigator.note_velocity(robot.twist)
        num_estimated, num_true, num_contacts = passed.counts.tolist()
        for x, y in passed.estimated[:num_estimated].tolist():
            robot.trail.append(Pose2D(x, y, 0.0))
            robot.pyramid.mark(x, y)
        for x, y in passed.true[:num_true].tolist():
            truth.trail.append(Pose2D(x, y, 0.0))
        flags = int(rows.flags[0])
        if flags & KEY_SCAN:
            robots.process_key_scan(0)
        env.task.update(env.simulator, env.robots, env.control_period)
        return count, num_contacts, progress, bool(flags & KEY_SCAN)

    def _next_noise(self) -> np.ndarray:
        """Return noise for the coming control periods, at most up to the end of the episode."""
        env = self._env
        if self._next == BLOCK:
            self._next = 0
            env.simulator.sensors.draw_rows(env.simulator.rngs[0], self._noise)
        left = math.ceil(min((env.time_limit - 1e-6) / env.control_period, 1e12)) - env.simulator.steps  # may be inf
        return self._noise[self._next : min(BLOCK, self._next + max(left, 1))]
