"""One robot in a PyBullet simulation: its body, and the controller between the command and the motors of its wheels."""

import math
from types import ModuleType

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.robots import RobotParams

from .bullet_bodies import CHASSIS_LINK, WHEEL_LINKS, build_robot
from .drive import Drive, check_command, count_substeps, plan_wheels
from .sensors import Sensors
from .simulator import Reading, TrueState, Twist

_NORMAL_FORCE = 9
"""Entry of a contact point that holds the force between the bodies."""
_OUT_OF_REACH = 1e3
"""Height at which a body touches nothing [m]."""


class BulletRobot:
    """A robot whose controller turns commands into wheel rates as it does under the kinematic physics.

    Motors of limited torque turn the wheels, and friction moves the robot. Wheel slip beyond what the contact itself
    yields is a disturbance of the wheel's rate that the encoder does not see.
    """

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        self._robot = robot
        self._drive = Drive.of(robot)
        self._period = float(control_period)
        self.substeps = count_substeps(self._drive, self._period)
        """Steps of physics in a control period."""
        self._sensors = Sensors(robot)
        self._rates, self._slips = np.empty((self.substeps, 2)), np.empty((self.substeps, 2))

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body [rad]."""
        _, orientation = self._bullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        roll, pitch, _ = self._bullet.getEulerFromQuaternion(orientation)
        return roll, pitch

    def build(self, bullet: ModuleType, client: int) -> None:
        """Put the body into a simulation."""
        self._bullet, self._client = bullet, client
        self._body = build_robot(bullet, client, self._robot)

    def lift(self, pose: Pose2D) -> None:
        """Take the robot away from everything, over where it shall stand: contacts remember their impulses."""
        for wheel in WHEEL_LINKS:
            self._bullet.resetJointState(self._body, wheel, 0.0, 0.0, physicsClientId=self._client)
        self._hold(pose, _OUT_OF_REACH)

    def put_down(self, pose: Pose2D, rng: np.random.Generator) -> None:
        """Put the robot at rest; all noise of the episode is drawn from `rng`."""
        self._hold(pose, self._robot.drive.wheel_radius)
        self._bullet.resetBaseVelocity(self._body, [0.0] * 3, [0.0] * 3, physicsClientId=self._client)
        self._rng = rng
        self._commanded = (0.0, 0.0)
        self._rolled, self._slipped = np.zeros(2), np.zeros(2)
        self._touched = False
        self._noise = self._sensors.draw(rng)
        self.observe()

    def plan(self, command: Twist) -> None:
        """Plan what the wheels do during the next control period.

        Raises:
            ValueError: the command holds NaN or infinity.
        """
        v, w = check_command(command)
        self._noise = self._sensors.draw(self._rng)
        normals, rates, slips = self._noise[0], self._rates, self._slips
        self._commanded = plan_wheels(
            *self._commanded, v, w, normals[0], normals[1], self._period, self._drive, rates, slips
        )
        self._rolled += rates.sum(axis=0) * (self._period / self.substeps)
        self._slipped += slips.sum(axis=0) * (self._period / self.substeps)
        self._targets = (rates + slips).tolist()
        self._touched = False

    def turn_wheels(self, substep: int) -> None:
        """Set the motors for a step of physics."""
        self._bullet.setJointMotorControlArray(
            self._body,
            WHEEL_LINKS,
            self._bullet.VELOCITY_CONTROL,
            targetVelocities=self._targets[substep],
            velocityGains=[1.0, 1.0],
            forces=[self._robot.drive.max_torque] * 2,
            physicsClientId=self._client,
        )

    def feel(self) -> None:
        """Take note of whether the body touches anything."""
        if not self._touched:
            points = self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK, physicsClientId=self._client)
            self._touched = any(point[_NORMAL_FORCE] > 0.0 for point in points)

    def observe(self) -> None:
        """Take note of where the robot truly is."""
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        linear, angular = self._bullet.getBaseVelocity(self._body, physicsClientId=self._client)
        rotation = self._bullet.getMatrixFromQuaternion(orientation)
        theta = math.atan2(rotation[3], rotation[0])
        speed = linear[0] * math.cos(theta) + linear[1] * math.sin(theta)
        self.state = TrueState(Pose2D(x, y, float(wrap_angle(theta))), Twist(speed, angular[2]))

    def read(self, time: float, segments: np.ndarray, circles: np.ndarray) -> Reading:
        """Return what the sensors say; see `Sensors.read`."""
        angles, pose, w = self._encoder_angles(), self.state.pose, self.state.twist.w
        return self._sensors.read(self._noise, time, pose, angles, w, self._touched, segments, circles)

    def _hold(self, pose: Pose2D, height: float) -> None:
        orientation = [0.0, 0.0, math.sin(0.5 * pose.theta), math.cos(0.5 * pose.theta)]
        position = [pose.x, pose.y, height]
        self._bullet.resetBasePositionAndOrientation(self._body, position, orientation, physicsClientId=self._client)

    def _encoder_angles(self) -> tuple[float, float]:
        if self._robot.odometry.open_loop:
            return float(self._rolled[0]), float(self._rolled[1])
        left, right = self._bullet.getJointStates(self._body, WHEEL_LINKS, physicsClientId=self._client)
        return left[0] - self._slipped[0], right[0] - self._slipped[1]
