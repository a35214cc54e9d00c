"""What `ReachGoal` knows of an episode: a row of numbers, which one kernel updates for one environment or many."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.contact import select_near
from lidarnaut.envs.transition import BY_ROBOT

GOAL_X, GOAL_Y, TRUE_X, TRUE_Y = range(4)
"""The goal, map frame and world frame [m]."""
TOLERANCE, ENDS, FIELD_X, FIELD_Y, FIELD_SIDE, LENGTH = range(4, 10)
"""Distance that counts as reached [m], 1 if contact ends the episode, corner and side of a cell of the geodesic field
[m], and geodesic distance from where the goal was set [m]."""
PROGRESS, TIME, COLLISION, CLEARANCE, PEOPLE = range(10, 15)
"""Quantities of the last period; see `ReachGoal.weights`."""
END, DISTANCE, LEFT, SHARE, SUCCESS = range(15, 20)
"""Index of the end reason, straight and geodesic distance to the goal [m], share of the path driven, 1 at the goal."""
MOVED_AT, JERK, LAST_V, LAST_ACC = range(20, 24)
"""Time at which the robot had moved [s], 0 before; jerk summed over periods [m/s3]; forward speed and acceleration of
the controller [m/s, m/s2]."""
SIZE = 24
"""Number of these entries."""
END_REASONS = (None, "reached", "wall", "person")
"""By `END`."""
AT_GOAL, AT_WALL, AT_PERSON = 1, 2, 3
NEAR_PERSON = 0.5
"""Gap to a person from which on nearness is free of charge [m]."""
NEAR_OBSTACLE = 0.15
"""Clearance from which on nearness to obstacles is free of charge [m]."""
MOVED = 0.1
"""Path after which a robot counts as moving [m]; the clock of BARN's metric starts there."""


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
    """Bring the task's row up to date after a control period; see `measure_goal`.

    `segments`, shape (n, 4), and `circles`, shape (m, 3), float64: all that rests [m].
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
    """Bring the rows of tasks of active environments up to date; `around`: see `step_rows`, `lengths`: a list, too."""
    for i in range(active.shape[0]):
        if active[i]:
            update_goal(rows[i], owns[i], lengths[i], surroundings[i][0], surroundings[i][1])
