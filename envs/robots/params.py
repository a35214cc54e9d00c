"""Robots as data. Pydantic refuses unknown keys, infinity, and numbers beyond the limits that a type names."""

import math
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from lidarnaut.envs.geometry.raycast import Beams

MAX_NUMBER = 1e9
"""No length, mass, rate, count or noise of a robot is greater than this, in SI units."""
MAX_LENGTH = 100.0
"""Greatest dimension of the body, and distance of it and of the lidar from the base [m]: maps have to hold what the
lidar sees."""
MAX_TILT = 0.35
"""Greatest tilt of a lidar that still scans the plane it is mounted in [rad]."""
MAX_BEAMS = 20_000
"""Most beams of a scan."""

Positive = Annotated[float, Field(gt=0.0, le=MAX_NUMBER)]
NotNegative = Annotated[float, Field(ge=0.0, le=MAX_NUMBER)]
Side = Annotated[float, Field(gt=0.0, le=MAX_LENGTH)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH, le=MAX_LENGTH)]
Tilt = Annotated[float, Field(ge=-MAX_TILT, le=MAX_TILT)]
CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True, config=CONFIG)
class Mount:
    """Where a sensor sits, in the frame of the robot's base (midpoint of the wheel axle, on the ground)."""

    x: Coordinate = 0.0
    """Forward of the base [m]."""
    y: Coordinate = 0.0
    """Left of the base [m]."""
    z: Coordinate = 0.0
    """Above the ground [m]."""
    yaw: float = 0.0
    """Rotation against the base, counter-clockwise [rad]."""
    pitch: Tilt = 0.0
    """Tilt that makes the sensor look down ahead where it is positive [rad]."""
    roll: Tilt = 0.0
    """Tilt that makes it look down to the right where it is positive [rad]."""

    def __post_init__(self) -> None:
        if (self.pitch or self.roll) and self.z <= 0.0:
            raise ValueError(f"a tilted mount must lie above the ground, got z = {self.z}")


@dataclass(frozen=True, slots=True, config=CONFIG)
class LidarParams:
    """A 2D lidar."""

    num_beams: Annotated[int, Field(ge=1, le=MAX_BEAMS)]
    """Beams per scan."""
    range_max: Positive
    """Farthest return [m]."""
    range_min: NotNegative = 0.0
    """Nearest return [m]."""
    fov: Annotated[float, Field(gt=0.0, le=2.0 * math.pi + 1e-9)] = 2.0 * math.pi
    """Field of view, centred on the sensor's x axis [rad]; a full turn does not repeat its first beam."""
    noise_std: NotNegative = 0.0
    """Standard deviation of the Gaussian range noise [m]."""
    resolution: NotNegative = 0.0
    """Step to which ranges are rounded [m]; 0 for none."""
    dropout: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Probability that a beam returns nothing at all."""
    mount: Mount = Mount()

    def __post_init__(self) -> None:
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min must be less than range_max, got {self.range_min} and {self.range_max}")

    @property
    def angle_increment(self) -> float:
        """Angle from one beam to the next [rad]."""
        full_turn = self.fov > 2 * math.pi - 1e-6
        return self.fov / (self.num_beams if full_turn else max(self.num_beams - 1, 1))

    @property
    def angle_min(self) -> float:
        """Angle of the first beam in the sensor's frame [rad]."""
        return -self.fov / 2 if self.num_beams > 1 else 0.0

    @property
    def angles(self) -> np.ndarray:
        """Angles of the beams in the sensor's frame, shape (num_beams,), float64 [rad]."""
        return self.angle_min + np.arange(self.num_beams) * self.angle_increment

    @property
    def beams(self) -> Beams:
        """Geometry of the beams, as kernels take it."""
        return Beams(self.angle_min, self.angle_increment, self.range_max)

    @property
    def directions(self) -> np.ndarray:
        """Cosine and sine of the beams' angles in the base frame, shape (2, num_beams), float64."""
        angles = self.angles + self.mount.yaw
        return np.stack([np.cos(angles), np.sin(angles)])


@dataclass(frozen=True, slots=True, config=CONFIG)
class DriveParams:
    """Two driven wheels on one axle, as they really are."""

    wheel_radius: Positive
    """Radius of the driven wheels [m]."""
    track: Positive
    """Distance between the wheels' contact points [m]."""
    wheel_width: Positive = 0.02
    """Width of a wheel [m]."""
    wheel_mass: Positive = 0.1
    """Mass of one wheel [kg]."""
    friction: Positive = 1.0
    """Coulomb friction between a wheel and the ground."""
    max_torque: Positive = 1.0
    """Greatest torque that a motor exerts on its wheel [N m]."""
    slip_std: NotNegative = 0.0
    """Standard deviation of the distance that a wheel slips while it rolls 1 m [m]; grows with the distance's root. No
    slip moves the robot at more than one and a half times its greatest speed and yaw rate."""

    def __post_init__(self) -> None:
        if self.wheel_width >= self.track:
            raise ValueError(f"wheel_width must be smaller than track, got {self.wheel_width} and {self.track}")


@dataclass(frozen=True, slots=True, config=CONFIG)
class OdometryNoise:
    """How far odometry may be off after a motion, as SLAMs weigh it against a scan.

    Standard deviations that grow with the distance d and the turn of the motion, after Thrun, Burgard and Fox,
    Probabilistic Robotics (2005), section 5.4: position_std + position_per_metre d along either axis, and
    heading_std + heading_per_radian |turn| + heading_per_metre d.
    """

    position_std: Positive = 0.003
    """Of the position, whatever the motion [m]."""
    position_per_metre: NotNegative = 0.02
    """Of the position, per distance [m/m]."""
    heading_std: Positive = 0.003
    """Of the heading, whatever the motion [rad]."""
    heading_per_radian: NotNegative = 0.03
    """Of the heading, per turn [rad/rad]."""
    heading_per_metre: NotNegative = 0.03
    """Of the heading, per distance [rad/m]."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class OdometryParams:
    """What the robot's own controller takes its wheels for. Where it errs, odometry is biased."""

    wheel_radius: Positive
    """Wheel radius that the controller assumes [m]."""
    track: Positive
    """Track that the controller assumes [m]."""
    ticks_per_rev: Positive
    """Encoder counts in one turn of a wheel."""
    uses_gyro: bool = False
    """Takes turns from the gyroscope, not from the wheels."""
    open_loop: bool = False
    """Counts the commanded steps instead of measured ones (stepper motors without encoders)."""
    noise: OdometryNoise = OdometryNoise()
    """What SLAMs take its errors for."""

    @property
    def ticks_per_radian(self) -> float:
        """Encoder counts per radian of a wheel's turn."""
        return self.ticks_per_rev / (2.0 * math.pi)

    @property
    def metres_per_tick(self) -> float:
        """Distance that a wheel rolls in one count [m]."""
        return 2.0 * math.pi * self.wheel_radius / self.ticks_per_rev


@dataclass(frozen=True, slots=True, config=CONFIG)
class Caster:
    """A ball that slides under the body, or hangs just above the ground."""

    x: Coordinate
    """Forward of the base [m]."""
    y: Coordinate
    """Left of the base [m]."""
    radius: Positive
    """Radius of the ball [m]."""
    clearance: NotNegative = 0.0
    """Gap between the ball and the ground while the robot is level [m]."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class BodyParams:
    """The rigid body that carries everything, as a box or, where `radius` is given, an upright cylinder."""

    mass: Positive
    """Mass without the wheels [kg]."""
    center: tuple[Coordinate, Coordinate, Coordinate]
    """Centre of the shape in the base frame, z above the ground [m]."""
    center_of_mass: tuple[Coordinate, Coordinate, Coordinate] | None = None
    """Centre of mass in the base frame, z above the ground [m]; None for the centre of the shape."""
    size: tuple[Side, Side, Side] | None = None
    """Length, width and height of the box [m]."""
    radius: Side | None = None
    """Radius of the cylinder [m]."""
    height: Side | None = None
    """Height of the cylinder [m]."""
    friction: NotNegative = 0.2
    """Coulomb friction between the body and obstacles; 0 for a smooth round body, which walls do not keep from turning
    and which would be turned into them if it rubbed."""

    def __post_init__(self) -> None:
        if (self.size is None, self.radius is None) != (self.height is not None, self.height is None):
            given = f"size {self.size}, radius {self.radius}, height {self.height}"
            raise ValueError(f"give either size or radius and height, got {given}")


@dataclass(frozen=True, slots=True, config=CONFIG)
class ImuParams:
    """Gyroscope and compass."""

    gyro_std: NotNegative = 0.0
    """Standard deviation of the yaw rate's noise [rad/s]."""
    gyro_bias_std: NotNegative = 0.0
    """Standard deviation of the yaw rate's bias, which stays the same from reset to reset [rad/s]."""
    has_compass: bool = False
    """Whether the robot has a compass."""
    compass_std: NotNegative = 0.0
    """Standard deviation of the heading [rad]."""
    compass_resolution: NotNegative = 0.0
    """Step to which the heading is rounded [rad]; 0 for none."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class RobotParams:
    """A differential-drive robot."""

    name: str
    """What users call it."""
    radius: Positive
    """Radius of the circle around the base that is the footprint in planning and in kinematic contact [m]."""
    max_v: Positive
    """Greatest forward (and backward) speed [m/s]."""
    max_w: Positive
    """Greatest yaw rate [rad/s]."""
    max_acc_v: Positive
    """Greatest change of forward speed [m/s2]."""
    max_acc_w: Positive
    """Greatest change of yaw rate [rad/s2]."""
    drive: DriveParams
    """The wheels as they are."""
    odometry: OdometryParams
    """The wheels as the controller takes them to be."""
    body: BodyParams
    lidar: LidarParams
    casters: tuple[Caster, ...] = ()
    imu: ImuParams = ImuParams()
    source: str = ""
    """Where the numbers come from."""
