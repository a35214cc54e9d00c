"""Drives of one robot, stepped by a kernel until the environment's or the navigator's objects are needed."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D
from envs.navigation import Navigator
from envs.navigation.navigator_kernels import DRIVING, check_progress, compute_velocity_command, update_obstacles
from envs.robot import REMEMBER, REMEMBER_TRUE, SCAN
from envs.simulation import records as at
from envs.simulation.kinematic import step_robots
from envs.simulation.rows import BLOCK
from envs.transition import update_robots

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
def drive(rows, draws, ranges, around, navigator, passed, max_steps, check_from):
    """Drive a robot up to a scan to process, until the noise is used up, or until its progress is to be judged.

    Args:
        rows: shape (1, ROW_SIZE), float64, written; see `envs.simulation.records`.
        draws: as for `step_robots`.
        ranges: as for `step_robots`.
        around: segments and circles of the world, which rests.
        navigator: `NavigatorArrays`, written.
        passed: `Passed`, written.
        max_steps: most control periods.
        check_from: control period of the drive from which on the navigator's objects check each one.

    Returns:
        Control periods, and the progress as `check_progress` returns it; `UNCHECKED` in the first two cases.
    """
    navigators, obstacles, constants = navigator.records, navigator.obstacles, navigator.numbers
    segments, circles = around
    row, record, no_points = rows[0], navigators[0], obstacles[:0]
    passed.counts[:] = 0
    num_steps = min(max_steps, draws.shape[1] - 1 - int(row[at.DRAW]))
    for k in range(num_steps):
        pose = (row[at.POSE], row[at.POSE + 1], row[at.POSE + 2])
        v, w = compute_velocity_command(navigators, navigator.path, obstacles, pose, row[at.TWIST_V], constants)
        row[at.COMMAND_V], row[at.COMMAND_W] = v, w
        step_robots(rows, draws, ranges, segments, circles, circles)
        update_robots(rows)
        flags, touched = int(row[at.FLAGS]), row[at.TOUCHED] > 0.0
        if flags & REMEMBER:
            _remember(passed.estimated, passed.counts, 0, row, at.POSE, at.TRAIL)
        if flags & REMEMBER_TRUE:
            _remember(passed.true, passed.counts, 1, row, at.X, at.TRUE_TRAIL)
        motion = (row[at.ODOMETRY], row[at.ODOMETRY + 1], row[at.ODOMETRY + 2])
        sensors = (ranges[0], navigator.directions, touched)
        update_obstacles(navigators, obstacles, sensors, motion, no_points, constants)
        if flags & SCAN or k == num_steps - 1:
            return k + 1, UNCHECKED
        pose = (row[at.POSE], row[at.POSE + 1], row[at.POSE + 2])
        progress = check_progress(navigators, obstacles, pose, touched, constants)
        if progress != DRIVING or record.steps >= check_from:
            return k + 1, progress
        passed.counts[2] += touched
    return 0, UNCHECKED


@njit(cache=True, error_model="numpy")
def _remember(positions, counts, kind, row, position, trail):
    positions[counts[kind]] = row[position : position + 2]
    row[trail : trail + 2] = row[position : position + 2]
    counts[kind] += 1


class FusedDrive:
    """Drives the robot of an environment by its navigator; see `drive`."""

    def __init__(self, env: Any, navigator: Navigator) -> None:
        """Take an environment of which `why_not` says nothing."""
        self._env, self._navigator = env, navigator
        self._passed = Passed(np.empty((BLOCK, 2)), np.empty((BLOCK, 2)), np.zeros(3, dtype=np.int64))

    @staticmethod
    def why_not(env: Any) -> str:
        """Return why control periods of a decision need Python one by one; empty where kernels do several at once."""
        if env.why_not_fused or not env.robots[0].follows_odometry:
            return env.why_not_fused or f"{type(env.robots[0].estimator).__name__} processes every scan"
        if not env.task.rests_between_scans:
            return f"task {type(env.task).__name__} looks at every control period"
        if env.world.movers or env.sensors or env.on_period or env.render_mode == "human":
            return "movers, own sensors, recorders and windows look at every control period"
        return ""

    def advance(self, check_from: float) -> tuple[int, int, int, bool]:
        """Drive for one or more control periods, and bring all objects up to date.

        The task processes the last one; those before it gained nothing.

        Args:
            check_from: see `drive`.

        Returns:
            Control periods; how many of them but for the last ended in contact; progress, see `drive`; and whether the
            scan was processed.
        """
        env, navigator, passed = self._env, self._navigator, self._passed
        simulator, robot, truth, rows = env.simulator, env.robots[0], env.truths[0], env.rows
        left = math.ceil(min((env.time_limit - 1e-6) / env.control_period, 1e12)) - rows.steps  # may be inf
        rows.draw_ahead(simulator.rngs)
        count, progress = drive(
            rows.numbers,
            rows.draws,
            rows.ranges,
            (env.world.segments, simulator.circles),
            navigator.arrays,
            passed,
            max(left, 1),
            min(check_from, 1 << 40),
        )
        v, w = rows.numbers[0, at.COMMAND_V : at.COMMAND_W + 1].tolist()
        robot.action = v / robot.params.max_v, w / robot.params.max_w
        navigator.velocity = robot.twist
        num_estimated, num_true, num_contacts = passed.counts.tolist()
        for x, y in passed.estimated[:num_estimated].tolist():
            robot.trail.append(Pose2D(x, y, 0.0))
            robot.pyramid.mark(x, y)
        for x, y in passed.true[:num_true].tolist():
            truth.trail.append(Pose2D(x, y, 0.0))
        env.finish()
        return count, num_contacts, progress, bool(int(robot.row[at.FLAGS]) & SCAN)
