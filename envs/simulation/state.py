"""A simulated robot as a row of numbers, which both physics, the sensors and the kernels of a step share."""

from .records import RobotRecord

X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W, MEAN_W, GYRO_BIAS = range(11)
"""Ground truth: pose in the world frame [m, m, rad], the controller's twist after its ramp [m/s, rad/s], how far
the wheels have turned since the reset, as encoders measure it [rad], the true twist of the base [m/s, rad/s], its mean
yaw rate during the last control period, and the bias of its gyroscope [rad/s]."""
STATE_SIZE = 11
"""Number of these entries."""
LEFT_TICKS, RIGHT_TICKS, YAW_RATE, HEADING, TOUCHED = range(11, 16)
"""Measurements beside the scan: encoder counts, gyroscope [rad/s], compass [rad], 1 for contact."""
STEPS, TIME, DRAW, COMMAND_V, COMMAND_W = range(16, 21)
"""Control periods and time [s] since the reset, row of `Rows.draws` in use, and commanded twist [m/s, rad/s]."""
LAST_X, LAST_Y, LAST_THETA, LAST_LEFT, LAST_RIGHT, LAST_TOUCHED = range(21, 27)
"""True pose, encoder counts and contact when the row was last brought up to date."""
ODOMETRY, MOTION, TWIST_V, TWIST_W, BIAS, BIAS_VARIANCE = 27, 30, *range(33, 37)
"""Motion during the period by odometry, and as the estimator learns of it (three entries each); velocity by odometry
or the estimator [m/s, rad/s]; the gyroscope's bias as odometry estimates it, and its variance."""
POSE, KEY_POSE, MAP_POSE, TRAIL, TRUE_TRAIL = 37, 40, 43, 46, 48
"""Pose estimate, predicted by odometry until the scan is processed, and that of the last key scan, map frame; pose of
the map frame in the world (three entries each); positions remembered last, estimated and true (two entries each)."""
PATH_LENGTH, COLLISIONS, ACTION_V, ACTION_W, FLAGS = range(50, 55)
"""Distance driven [m] and contacts so far, the last action, and what is left to do for the robot."""
SETUP, ROBOT = 55, 62
"""Where the `Setup` of `envs.robot` and the robot's `RobotRecord` begin; both outlive a reset."""
PERIOD = ROBOT + RobotRecord._fields.index("period")
"""The control period [s]."""
ROW_SIZE = ROBOT + len(RobotRecord._fields)
"""Number of entries of a row."""
