"""Layout of the state vector (row) of a person."""

X, Y, VX, VY, RADIUS, SPEED, KIND, GOAL, TRIP, SLOW, HEADING, PHASE, BLOCKED = range(13)
"""Columns of a person's state vector, in m, s and rad.

`SPEED`: desired speed. `GOAL`: index of the destination. `TRIP`: number of destinations so far. `SLOW`: time of slow
walking. `PHASE`: phase of the stride. `BLOCKED`: speed of walking into a robot."""
DRAWS, NUM_DRAWS = 13, 64
"""First column and number of the random numbers, uniform in [0, 1), in a person's state vector that choose
destinations."""
PERSON_SIZE = DRAWS + NUM_DRAWS
ATTENTIVE, BLIND, STANDING, FIXED_ROUTE = range(4)
"""Kinds of people: avoiding robots, not avoiding robots, standing, and on a fixed route. All stop when they reach a
robot."""
ORCA, LEGS, ORIGIN_X, ORIGIN_Y, ROWS, COLS, MODEL, WALLS = *range(7), 16
"""Indices in `People.setup`, the packed parameters of the pedestrian model and the static obstacles.

`ORCA`, `LEGS`: flags for the ORCA model and for visible legs. `MODEL`, `WALLS`: first entries of the model's parameters
and of the obstacle table `Walls.near`. The others describe the table's grid."""
