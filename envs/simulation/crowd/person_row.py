"""Layout of a person's row of numbers."""

X, Y, VX, VY, RADIUS, SPEED, KIND, GOAL, TRIP, SLOW, HEADING, PHASE, BLOCKED = range(13)
"""Columns of a person's row.

World position [m] and velocity [m/s], radius [m], desired speed [m/s], kind, row of the destination in `People.points`,
number of trips, time of slow progress [s], heading [rad], stride phase [rad], and speed towards a robot that stopped
the person [m/s]."""
DRAWS, NUM_DRAWS = 13, 64
"""First column and number of uniform random numbers in [0, 1) for trips."""
PERSON_SIZE = DRAWS + NUM_DRAWS
ATTENTIVE, BLIND, STANDING, FIXED_ROUTE = range(4)
"""Kinds of people: avoiding robots, blind to robots, standing, on a fixed route; all kinds stop at robots."""
ORCA, LEGS, ORIGIN_X, ORIGIN_Y, ROWS, COLS, MODEL, WALLS = *range(7), 16
"""Entries of `People.setup`: ORCA or not, legs or not, `Walls.grid`, start of the model's parameters and of
`Walls.near`."""
