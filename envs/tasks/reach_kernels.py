"""State array of the task `ReachGoal`, and compiled functions that update it."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.pose import distance, wrap_angle
from lidarnaut.envs.simulation.contact import select_near
from lidarnaut.envs.transition import BY_ROBOT

GOAL_X, GOAL_Y, TRUE_X, TRUE_Y = range(4)
"""Indices in the task's state array: goal (x, y) in the map frame and in the world frame [m]."""
TOLERANCE, ENDS, FIELD_X, FIELD_Y, FIELD_SIDE, LENGTH = range(4, 10)
"""Indices in the task's state array: constants of an episode. `ENDS`: 1 if contact ends the episode; `FIELD_...`:
origin and cell size of the grid of geodesic distances [m]; `LENGTH`: geodesic distance from start to goal [m]."""
PROGRESS, TIME, COLLISION, CLEARANCE, PEOPLE = range(10, 15)
"""Indices in the task's state array: reward terms of the last control period, before weighting."""
END, DISTANCE, LEFT, SHARE, SUCCESS = range(15, 20)
"""Indices in the task's state array: end reason and metrics. `LEFT`: geodesic distance to the goal [m]; `SHARE`: driven
fraction of the initial geodesic distance."""
MOVED_AT, JERK = range(20, 22)
"""Indices in the task's state array: time of first motion [s], summed absolute jerk [m/s3]."""
TRUE_THETA, TURN = range(22, 24)
"""Indices in the task's state array: heading of the goal in the world frame, and its tolerance [rad]."""
SIZE = 24
END_REASONS = (None, "reached", "wall", "person")
AT_GOAL, AT_WALL, AT_PERSON = 1, 2, 3
NEAR_PERSON = 0.5
"""Gap between robot and person below which the reward decreases [m]."""
NEAR_OBSTACLE = 0.15
"""Gap between robot and obstacles below which the reward decreases [m]."""
MOVED = 0.1
"""Driven length after which the clock of the BARN benchmark starts [m]."""


@njit(cache=True, error_model="numpy")
def measure_goal(row, own, lengths):
    """Update distances to the goal, driven fraction of the path, and success in the task's state array `own`.

    `row`: record of the robot; `lengths`: raster of geodesic distances to the goal, float32 [m], inf outside free
    space. While the robot is outside free space, its geodesic distance keeps the last value.
    """
    x, y = row.x, row.y
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
    turn = abs(wrap_angle(row.theta - own[TRUE_THETA]))
    own[SUCCESS] = own[DISTANCE] <= own[TOLERANCE] and turn <= own[TURN]
    own[SHARE] = 1.0 if own[SUCCESS] > 0.0 else max(0.0, 1.0 - own[LEFT] / max(own[LENGTH], 1e-9))


@njit(cache=True, error_model="numpy")
def update_goal(rows, own, lengths, segments, circles):
    """Update reward terms, metrics and end reason in the task's state array `own` after a control period.

    `rows`: record of one robot, shape (1,). `segments`, shape (n, 4), `circles`, shape (m, 3): static obstacles,
    float64 [m].
    """
    row = rows[0]
    x, y, radius, period = row.x, row.y, row.radius, row.period
    before, touched = own[LEFT], row.touched > 0.0
    measure_goal(row, own, lengths)
    own[PROGRESS], own[TIME], own[COLLISION] = before - own[LEFT], period, period * touched
    own[END] = AT_GOAL * own[SUCCESS]
    if touched and own[ENDS] > 0.0:
        own[END] = AT_PERSON if row.touched_by >= BY_ROBOT else AT_WALL
        own[SUCCESS], own[COLLISION] = 0.0, 1.0
    near = np.empty(segments.shape[0] + 1, dtype=np.int64)
    num_near = select_near(x, y, radius + NEAR_OBSTACLE, segments, near)
    free = clearance(x, y, segments[near[:num_near]], circles) - radius
    own[CLEARANCE] = period * min(max((NEAR_OBSTACLE - free) / NEAR_OBSTACLE, 0.0), 1.0)
    own[PEOPLE] = period * min(max((NEAR_PERSON - row.person_gap) / NEAR_PERSON, 0.0), 1.0)
    if own[MOVED_AT] == 0.0 and row.path_length >= MOVED:
        own[MOVED_AT] = row.time
    own[JERK] += row.jerk


@njit(cache=True, error_model="numpy")
def update_goals(rows, owns, lengths, surroundings, active):
    """Update reward terms, metrics and end reasons after a control period, for several environments.

    `active`: mask of environments; `surroundings`: static obstacles (segments, circles).
    """
    for i in range(active.shape[0]):
        if active[i]:
            update_goal(rows[i : i + 1], owns[i], lengths[i], surroundings[i][0], surroundings[i][1])
