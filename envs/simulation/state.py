"""The state of a simulated robot as a row of numbers, which both physics write and the sensors read."""

X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W, MEAN_W, GYRO_BIAS = range(11)
"""Entries of a row: pose in the world frame [m, m, rad], the controller's twist after its ramp [m/s, rad/s], how far
the wheels have turned since the reset, as encoders measure it [rad], the true twist of the base [m/s, rad/s], its mean
yaw rate during the last control period, and the bias of its gyroscope [rad/s]."""
STATE_SIZE = 11
"""Number of entries of a row."""
