"""A robot as a motion model: wheels that roll and slip, and a circular footprint that slides along obstacles."""

import math

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.robots import RobotParams
from envs.worlds import World

from .contact import check_start, push_out, select_near
from .drive import Drive, check_command, count_substeps, plan_wheels
from .sensors import Sensors
from .simulator import Reading, TrueState, Twist

X, Y, THETA, COMMANDED_V, COMMANDED_W, LEFT_ANGLE, RIGHT_ANGLE, V, W = range(9)
"""Entries of the state: pose in the world frame [m, m, rad], the controller's twist after its ramp [m/s, rad/s], how
far the wheels have turned since the reset [rad], and the true twist of the base [m/s, rad/s]."""
STATE_SIZE = 9
"""Number of entries of the state."""
ALONE = np.empty((0, 3))
"""The mates of a robot without any."""


@njit(cache=True, error_model="numpy")
def advance(state, command_v, command_w, normal_left, normal_right, period, substeps, drive, segments, before, after):
    """Move the robot for one control period.

    The command is clipped, ramped and turned into wheel rates as the controller takes the wheels to be; the wheels
    roll as they are, and slip. The base follows the arc of each substep. What the footprint then overlaps pushes it
    out along the normal, so that it slides along walls; where that leaves it wedged, it stays where it was.
    Wheels keep turning while the robot is held.

    Args:
        state: shape (9,), float64, changed in place; see `X` and its neighbours.
        command_v: commanded forward speed [m/s].
        command_w: commanded yaw rate [rad/s].
        normal_left: standard normal draw for the left wheel's slip.
        normal_right: the same for the right wheel.
        period: control period [s].
        substeps: into how many equal parts the period is cut.
        drive: the robot.
        segments: shape (n, 4), float64, (x0, y0, x1, y1) [m].
        before: shape (m, 3), float64, circles at the start of the period, (x, y, radius) [m].
        after: shape (m, 3), float64, the same circles at its end; movers move evenly in between [m].

    Returns:
        Whether the footprint touched anything, and which circles it touched: shape (m,), bool.
    """
    dt = period / substeps
    fastest = drive.max_v * drive.wheel_radius / drive.assumed_wheel_radius
    near = np.empty(segments.shape[0] + 1, dtype=np.int64)
    num_near = select_near(state[X], state[Y], 2.0 * (drive.radius + fastest * period), segments, near)
    circles, hits = before.copy(), np.zeros(before.shape[0], dtype=np.bool_)
    rates, slips = np.empty((substeps, 2)), np.empty((substeps, 2))
    state[COMMANDED_V], state[COMMANDED_W] = plan_wheels(
        state[COMMANDED_V],
        state[COMMANDED_W],
        command_v,
        command_w,
        normal_left,
        normal_right,
        period,
        drive,
        rates,
        slips,
    )
    touched = False
    for step in range(substeps):
        left = (rates[step, 0] + slips[step, 0]) * drive.wheel_radius * dt
        right = (rates[step, 1] + slips[step, 1]) * drive.wheel_radius * dt
        turn = (right - left) / drive.track
        half = 0.5 * turn
        chord = 0.5 * (left + right) * (math.sin(half) / half if half != 0.0 else 1.0)
        x, y, theta = state[X], state[Y], state[THETA]
        part = (step + 1) / substeps
        for i in range(circles.shape[0]):
            circles[i, 0] = before[i, 0] + part * (after[i, 0] - before[i, 0])
            circles[i, 1] = before[i, 1] + part * (after[i, 1] - before[i, 1])
        c, s = math.cos(theta + half), math.sin(theta + half)
        new_x, new_y, contact, free = push_out(
            x + chord * c, y + chord * s, drive.radius, segments, near, num_near, circles, hits
        )
        touched |= contact
        if not free:
            new_x, new_y = x, y
        state[X], state[Y], state[THETA] = new_x, new_y, wrap_angle(theta + turn)
        state[LEFT_ANGLE] += rates[step, 0] * dt
        state[RIGHT_ANGLE] += rates[step, 1] * dt
        state[V], state[W] = ((new_x - x) * c + (new_y - y) * s) / dt, turn / dt
    return touched, hits


class KinematicSimulator:
    """A robot in a world, moved by `advance`. Needs no PyBullet."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        self._robot = robot
        self.drive = Drive.of(robot)
        self._period = float(control_period)
        self.substeps = count_substeps(self.drive, self._period)
        self._sensors = Sensors(robot)
        self.row = np.zeros(STATE_SIZE)
        """Shape (9,), float64: the state that `advance` moves on."""
        self._steps = 0
        self._world: World | None = None
        self.rng = np.random.default_rng(0)
        self.circles = np.empty((0, 3))

    @property
    def state(self) -> TrueState:
        """The truth after the last `reset` or `step`."""
        x, y, theta, _, _, _, _, v, w = self.row.tolist()
        return TrueState(Pose2D(x, y, theta), Twist(v, w))

    def reset(self, world: World, pose: Pose2D, rng: np.random.Generator) -> Reading:
        """Put the robot at rest at `pose` (world frame) and return its first reading.

        Raises:
            ValueError: the robot does not fit there.
        """
        self.place(world, pose, rng)
        return self.read(bumper=False)

    def step(self, command: Twist) -> Reading:
        """Drive with the commanded twist for one control period and return what the sensors say at its end.

        Raises:
            ValueError: the command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        return self.read(self.move(command)[0])

    def place(self, world: World, pose: Pose2D, rng: np.random.Generator) -> None:
        """Put the robot at rest at `pose` (world frame); the first part of `reset`.

        Raises:
            ValueError: the robot does not fit there.
        """
        circles = world.circles_at(0.0)
        check_start(pose, self._robot.radius, world.segments, circles, world.name)
        self._world, self.rng, self.circles, self._steps = world, rng, circles, 0
        self.row[:] = 0.0
        self.row[X], self.row[Y], self.row[THETA] = pose.x, pose.y, wrap_angle(pose.theta)
        self._noise = self._sensors.draw(rng)

    def move(self, command: Twist, mates: np.ndarray = ALONE) -> tuple[bool, np.ndarray]:
        """Drive with the commanded twist for one control period; the first part of `step`.

        Args:
            command: the twist.
            mates: shape (m, 3), float64, other robots, which stand still meanwhile, as circles (x, y, radius) [m].

        Returns:
            Whether the robot touched anything, and which mates it touched: shape (m,), bool.

        Raises:
            ValueError: the command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        if self._world is None:
            raise RuntimeError("call reset before step")
        v, w = check_command(command)
        self._noise = self._sensors.draw(self.rng)
        self._steps += 1
        before = self.circles
        if self._world.movers:
            self.circles = self._world.circles_at(self._steps * self._period)
        touched, hits = advance(
            self.row,
            v,
            w,
            self._noise[0][0],
            self._noise[0][1],
            self._period,
            self.substeps,
            self.drive,
            self._world.segments,
            _joined(before, mates),
            _joined(self.circles, mates),
        )
        return bool(touched), hits[len(before) :]

    def read(self, bumper: bool, mates: np.ndarray = ALONE) -> Reading:
        """Return what the sensors say; the second part of `reset` and `step`.

        Args:
            bumper: whether the robot touched anything.
            mates: see `move`.
        """
        assert self._world is not None
        x, y, theta, _, _, left, right, _, w = self.row.tolist()
        return self._sensors.read(
            self._noise,
            self._steps * self._period,
            Pose2D(x, y, theta),
            (left, right),
            w,
            bumper,
            self._world.segments,
            _joined(self.circles, mates),
        )

    def close(self) -> None:
        """Release what the simulator holds: nothing."""


def _joined(circles: np.ndarray, mates: np.ndarray) -> np.ndarray:
    return np.vstack([circles, mates]) if len(mates) else circles
