"""State of an episode of `ReachGoal` as an array of numbers, updated by kernels for one or many environments."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.contact import select_near
from lidarnaut.envs.transition import BY_ROBOT

GOAL_X, GOAL_Y, TRUE_X, TRUE_Y = range(4)
"""Indices of the goal in the task's row: map frame and world frame [m]."""
TOLERANCE, ENDS, FIELD_X, FIELD_Y, FIELD_SIDE, LENGTH = range(4, 10)
"""Indices in the task's row: goal tolerance [m], 1 if contact ends the episode, origin and cell size of the geodesic
field [m], initial geodesic distance [m]."""
PROGRESS, TIME, COLLISION, CLEARANCE, PEOPLE = range(10, 15)
"""Indices of the reward quantities of the last period; see `ReachGoal.weights`."""
END, DISTANCE, LEFT, SHARE, SUCCESS = range(15, 20)
"""Indices in the task's row: end reason, straight and geodesic distance to the goal [m], driven fraction, 1 at the
goal."""
MOVED_AT, JERK, LAST_V, LAST_ACC = range(20, 24)
"""Indices in the task's row: time of first motion [s] or 0, sum of absolute jerk over periods [m/s3], last commanded
forward speed [m/s] and acceleration [m/s2]."""
SIZE = 24
"""Length of the task's row."""
END_REASONS = (None, "reached", "wall", "person")
"""Names of end reasons, by the value at index `END`."""
AT_GOAL, AT_WALL, AT_PERSON = 1, 2, 3
NEAR_PERSON = 0.5
"""Gap to a person below which the reward is reduced [m]."""
NEAR_OBSTACLE = 0.15
"""Clearance to obstacles below which the reward is reduced [m]."""
MOVED = 0.1
"""Path length at which a robot counts as moving [m] and the clock of BARN's metric starts."""


@njit(cache=True, error_model="numpy")
def measure_goal(row, own, lengths):
    """Measure where the goal is from a robot's row: `DISTANCE`, `LEFT`, `SHARE`, `SUCCESS` of the task's row `own`.

    `lengths`: shape (height, width), float32, geodesic distances of the cells of a raster [m], inf where the robot does
    not fit. The least sum of those of the cells around the robot and the straight line there counts; where it fits in
    none of them, the last value.
    """
    x, y = row[at.X], row[at.Y]
    own[DISTANCE] = distance(own[TRUE_X] - x, own[TRUE_Y] - y)
    side, left, low = own[FIELD_SIDE], own[FIELD_X], own[FIELD_Y]
    middle_row, middle_col = math.floor((y - low) / side), math.floor((x - left) / side)
    best = np.inf
    for i in range(max(middle_row - 1, 0), min(middle_row + 2, lengths.shape[0])):
        for j in range(max(middle_col - 1, 0), min(middle_col + 2, lengths.shape[1])):
            straight = distance(left + (j + 0.5) * side - x, low + (i + 0.5) * side - y)
            best = min(best, float(lengths[i, j]) + straight)
    if best < np.inf:
        own[LEFT] = best
    own[SUCCESS] = own[DISTANCE] <= own[TOLERANCE]
    own[SHARE] = 1.0 if own[SUCCESS] > 0.0 else max(0.0, 1.0 - own[LEFT] / max(own[LENGTH], 1e-9))


@njit(cache=True, error_model="numpy")
def update_goal(row, own, lengths, segments, circles):
    """Update the task's row after a control period.

    `segments`, shape (n, 4), and `circles`, shape (m, 3), float64, are static obstacles [m].
    """
    x, y, radius, period = row[at.X], row[at.Y], row[at.ROBOT], row[at.PERIOD]
    before, touched = own[LEFT], row[at.TOUCHED] > 0.0
    measure_goal(row, own, lengths)
    own[PROGRESS], own[TIME], own[COLLISION] = before - own[LEFT], period, period * touched
    own[END] = AT_GOAL * own[SUCCESS]
    if touched and own[ENDS] > 0.0:
        own[END] = AT_PERSON if row[at.TOUCHED_BY] >= BY_ROBOT else AT_WALL
        own[SUCCESS], own[COLLISION] = 0.0, 1.0
    near = np.empty(segments.shape[0] + 1, dtype=np.int64)
    num_near = select_near(x, y, radius + NEAR_OBSTACLE, segments, near)
    free = clearance(x, y, segments[near[:num_near]], circles) - radius
    own[CLEARANCE] = period * min(max((NEAR_OBSTACLE - free) / NEAR_OBSTACLE, 0.0), 1.0)
    own[PEOPLE] = period * min(max((NEAR_PERSON - row[at.PERSON_GAP]) / NEAR_PERSON, 0.0), 1.0)
    if own[MOVED_AT] == 0.0 and row[at.PATH_LENGTH] >= MOVED:
        own[MOVED_AT] = row[at.TIME]
    acceleration = (row[at.COMMANDED_V] - own[LAST_V]) / period
    own[JERK] += abs(acceleration - own[LAST_ACC]) / period
    own[LAST_V], own[LAST_ACC] = row[at.COMMANDED_V], acceleration


@njit(cache=True, error_model="numpy")
def update_goals(rows, owns, lengths, surroundings, active):
    """Update the tasks' rows of active environments; `surroundings`: see `step_rows`; `lengths`: one array each."""
    for i in range(active.shape[0]):
        if active[i]:
            update_goal(rows[i], owns[i], lengths[i], surroundings[i][0], surroundings[i][1])
