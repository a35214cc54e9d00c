"""A person as a row of numbers, which the pedestrian models, the sensors and the kernels of a step share."""

X, Y, VX, VY, RADIUS, SPEED, KIND, GOAL, TRIP, SLOW, HEADING, PHASE, BLOCKED = range(13)
"""Position and velocity in the world frame [m, m/s], radius [m], desired speed [m/s], one of the kinds below, row of
`People.points` that is walked to, trips so far, time of being slow [s], direction of walking [rad], phase of the stride
[rad], and the speed towards a robot at which it was stopped by it during the period [m/s]."""
DRAWS, NUM_DRAWS = 13, 64
"""Where uniform draws in [0, 1) begin, one for each trip, and how many there are; then they repeat."""
PERSON_SIZE = DRAWS + NUM_DRAWS
"""Number of entries of a row."""
ATTENTIVE, BLIND, STANDING, FIXED_ROUTE = range(4)
"""Kinds of people: who sees robots and gives way, who does not see them, who stands still, and who walks along a fixed
line and gives way to nobody. All of them stop where they would walk into a robot."""
ORCA, LEGS, ORIGIN_X, ORIGIN_Y, ROWS, COLS, MODEL, WALLS = *range(7), 16
"""Entries of `People.setup`: 1 for ORCA, 0 for the social force model; 1 where lidars see legs, 0 where discs; numbers
of `Walls`; and where the model's parameters and `Walls.near` begin."""
