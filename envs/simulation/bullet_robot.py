"""One robot in a PyBullet simulation: its body, and the controller between the command and the motors of its wheels."""

import math

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.robots import RobotParams

from .bullet_bodies import CHASSIS_LINK, WHEEL_LINKS, build_robot
from .bullet_client import BulletClient
from .drive import plan_wheels
from .records import robot_record, unpack_robot
from .state import COMMANDED_V, COMMANDED_W, LEFT_ANGLE, MEAN_W, RIGHT_ANGLE, THETA, V, W, X, Y

_NORMAL_FORCE = 9
"""Entry of a contact point that holds the force between the bodies."""
_OUT_OF_REACH = 1e3
"""Height at which a body touches nothing [m]."""


@njit(cache=True, error_model="numpy")
def _plan_wheels(reached, command, normals, numbers, rates, slips):
    """Call `plan_wheels` for numbers that Python hands over fast; see `unpack_robot`."""
    return plan_wheels(reached, command, normals, unpack_robot(numbers), rates, slips)


class BulletRobot:
    """A robot whose controller turns commands into wheel rates as it does under the kinematic physics.

    Motors of limited torque turn the wheels, and friction moves the robot. Wheel slip beyond what the contact itself
    yields is a disturbance of the wheel's rate that the encoder does not see.
    """

    def __init__(self, robot: RobotParams, control_period: float, row: np.ndarray) -> None:
        """Prepare a robot whose state is written to `row`, shape (11,), float64; see `state`."""
        record = robot_record(robot, control_period)
        self._robot, self._numbers, self._row = robot, np.array(record), row
        substeps, self._period = int(record.substeps), record.period
        self._dt = self._period / substeps
        self._rates, self._slips = np.empty((substeps, 2)), np.empty((substeps, 2))
        self.touched = False
        """Whether the body touched anything during the control period."""

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body [rad]."""
        _, orientation = self._bullet.getBasePositionAndOrientation(self._body)
        roll, pitch, _ = self._bullet.getEulerFromQuaternion(orientation)
        return roll, pitch

    def build(self, bullet: BulletClient) -> None:
        """Put the body into a simulation."""
        self._bullet, self._body = bullet, build_robot(bullet, self._robot)

    def move_away(self, pose: Pose2D) -> None:
        """Reset the wheels high above a pose, where nothing is: contacts remember their impulses."""
        for wheel in WHEEL_LINKS:
            self._bullet.resetJointState(self._body, wheel, 0.0, 0.0)
        self._set_pose(pose, _OUT_OF_REACH)

    def reset_pose(self, pose: Pose2D) -> None:
        """Place the robot at rest."""
        self._set_pose(pose, self._robot.drive.wheel_radius)
        self._bullet.resetBaseVelocity(self._body, [0.0] * 3, [0.0] * 3)
        self._row[:] = 0.0
        self._rolled, self._slipped = np.zeros(2), np.zeros(2)
        self.touched = False
        self.update_state()
        self._row[MEAN_W] = 0.0

    def plan(self, command: np.ndarray, normals: np.ndarray) -> None:
        """Plan what the wheels do during the next control period.

        Args:
            command: shape (2,), float64, twist (v, w), finite [m/s, rad/s].
            normals: shape (n,), float64, standard normal draws; the first two are for the slip of the wheels.
        """
        row, rates, slips = self._row, self._rates, self._slips
        reached = (row[COMMANDED_V], row[COMMANDED_W])
        row[COMMANDED_V], row[COMMANDED_W] = _plan_wheels(reached, command, normals, self._numbers, rates, slips)
        self._targets = (rates + slips).tolist()
        if self._robot.odometry.open_loop:
            self._rolled += rates.sum(axis=0) * self._dt
        self._slipped += slips.sum(axis=0) * self._dt
        self.touched = False

    def turn_wheels(self, substep: int) -> None:
        """Set the motors for a step of physics."""
        self._bullet.setJointMotorControlArray(
            self._body,
            WHEEL_LINKS,
            self._bullet.VELOCITY_CONTROL,
            targetVelocities=self._targets[substep],
            velocityGains=[1.0, 1.0],
            forces=[self._robot.drive.max_torque] * 2,
        )

    def update_contacts(self) -> None:
        """Read from the engine whether the body touches anything."""
        if not self.touched:
            points = self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK)
            self.touched = any(point[_NORMAL_FORCE] > 0.0 for point in points)

    def update_state(self) -> None:
        """Read pose, velocity and wheel angles from the engine."""
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body)
        linear, angular = self._bullet.getBaseVelocity(self._body)
        rotation = self._bullet.getMatrixFromQuaternion(orientation)
        theta = math.atan2(rotation[3], rotation[0])
        row = self._row
        # Headings tell turns up to whole circles; which of them it was the command tells.
        period, expected = self._period, row[COMMANDED_W]
        row[MEAN_W] = expected + wrap_angle(theta - row[THETA] - expected * period) / period
        row[X], row[Y], row[THETA] = x, y, wrap_angle(theta)
        row[V], row[W] = linear[0] * math.cos(theta) + linear[1] * math.sin(theta), angular[2]
        if self._robot.odometry.open_loop:
            row[LEFT_ANGLE], row[RIGHT_ANGLE] = self._rolled
        else:
            left, right = self._bullet.getJointStates(self._body, WHEEL_LINKS)
            row[LEFT_ANGLE], row[RIGHT_ANGLE] = left[0] - self._slipped[0], right[0] - self._slipped[1]

    def _set_pose(self, pose: Pose2D, height: float) -> None:
        orientation = [0.0, 0.0, math.sin(0.5 * pose.theta), math.cos(0.5 * pose.theta)]
        position = [pose.x, pose.y, height]
        self._bullet.resetBasePositionAndOrientation(self._body, position, orientation)
