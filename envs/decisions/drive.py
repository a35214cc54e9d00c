"""Numba kernel that drives one robot for several control periods."""

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.navigation.controllers.navigator_kernels import (
    DRIVING,
    check_progress,
    compute_velocity_command,
    update_obstacles,
)
from lidarnaut.envs.robot import ONE_ACTIVE, SCAN
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.kinematic import step_robots
from lidarnaut.envs.transition import record_positions, update_robots

UNCHECKED = -1
"""Returned by `drive` if arrival and stall were not checked in the last control period."""


@njit(cache=True, error_model="numpy")
def drive(rows, draws, ranges, world_arrays, navigator, noted, max_steps, check_from):
    """Simulate a robot that follows its navigator for up to `max_steps` control periods.

    Stops earlier at the goal, on failure, or for work in Python: scan matching, checks, or new random numbers.
    `navigator`: arrays of the navigator, updated. `noted`: `positions` and `counts` of `record_positions`.
    `check_from`: first control period with a check in Python.

    Returns:
        Number of control periods; status of the drive as in `check_progress`, or `UNCHECKED`; number of control periods
        with contact, without the last one.
    """
    navigators, obstacles, constants = navigator.records, navigator.obstacles, navigator.numbers
    segments, circles, magnets, crowd = world_arrays
    row, record, no_points = rows[0], navigators[0], obstacles[:0]
    noted[1][:] = contacts = 0
    num_steps = min(max_steps, draws.shape[1] - 1 - int(row[at.DRAW]))
    for k in range(num_steps):
        pose = (row[at.POSE], row[at.POSE + 1], row[at.POSE + 2])
        v, w = compute_velocity_command(navigators, navigator.path, obstacles, pose, row[at.TWIST_V], constants)
        row[at.COMMAND_V], row[at.COMMAND_W] = v, w
        step_robots(rows, draws, ranges, segments, circles, magnets, crowd)
        update_robots(rows, crowd[0])
        flags, touched = int(row[at.FLAGS]), row[at.TOUCHED] > 0.0
        record_positions(rows, ONE_ACTIVE, *noted)
        motion = (row[at.ODOMETRY], row[at.ODOMETRY + 1], row[at.ODOMETRY + 2])
        sensors = (ranges[0], navigator.geometry, touched)
        update_obstacles(navigators, obstacles, sensors, motion, no_points, constants)
        if flags & SCAN or k == num_steps - 1:
            return k + 1, UNCHECKED, contacts
        pose = (row[at.POSE], row[at.POSE + 1], row[at.POSE + 2])
        progress = check_progress(navigators, obstacles, pose, touched, constants)
        if progress != DRIVING or record.steps >= check_from:
            return k + 1, progress, contacts
        contacts += touched
    return 0, UNCHECKED, contacts
