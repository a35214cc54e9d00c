"""Layout of the state vector (row) of a person."""

X, Y, VX, VY, RADIUS, SPEED, KIND, GOAL, TRIP, SLOW, HEADING, PHASE, BLOCKED = range(13)
"""Columns of a person's state vector.

World position [m] and velocity [m/s]; radius [m]; desired speed [m/s]; kind, such as `ATTENTIVE`; index of the
destination; number of destinations so far; time of slow progress [s]; heading [rad]; stride phase [rad]; speed of
walking into a robot [m/s]."""
DRAWS, NUM_DRAWS = 13, 64
"""First column and number of random numbers, uniform in [0, 1), that decide a person's destinations."""
PERSON_SIZE = DRAWS + NUM_DRAWS
ATTENTIVE, BLIND, STANDING, FIXED_ROUTE = range(4)
"""Kinds of people: avoiding robots, not avoiding robots, standing, and on a fixed route. All stop when they reach a
robot."""
ORCA, LEGS, ORIGIN_X, ORIGIN_Y, ROWS, COLS, MODEL, WALLS = *range(7), 16
"""Indices in `People.setup`: flags for ORCA and for visible legs; origin (x, y), rows and columns of the obstacle grid;
first parameter of the pedestrian model; start of the obstacle lists `Walls.near`."""
