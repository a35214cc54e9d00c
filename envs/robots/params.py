"""Robots as data."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ConfigDict

from envs.geometry.raycast import Beams


def _require(condition: bool, what: str, value: Any) -> None:
    if not condition:
        raise ValueError(f"{what}, got {value!r}")


MAX_NUMBER = 1e9
"""No length, mass, rate, count or noise of a robot is greater than this, in SI units."""
MAX_LENGTH = 100.0
"""Greatest dimension of the body, and distance of it and of the lidar from the base [m]: maps have to hold what the
lidar sees."""
MAX_BEAMS = 20_000
"""Most beams of a scan."""


class _Params:
    """What all parameters share: pydantic refuses unknown keys and infinity, and numbers have signs and limits."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    def _require_positive(self, *fields: str) -> None:
        for field in fields:
            _require(getattr(self, field) > 0, f"{field} must be positive", getattr(self, field))
            self._require_at_most(field)

    def _require_not_negative(self, *fields: str) -> None:
        for field in fields:
            _require(getattr(self, field) >= 0, f"{field} must not be negative", getattr(self, field))
            self._require_at_most(field)

    def _require_at_most(self, *fields: str, limit: float = MAX_NUMBER) -> None:
        for field in fields:
            value = getattr(self, field)
            _require(abs(value) <= limit, f"{field} must lie within {limit:g}", value)


MAX_TILT = 0.35
"""Greatest tilt of a lidar that still scans the plane it is mounted in [rad]."""


@dataclass(frozen=True, slots=True)
class Mount(_Params):
    """Where a sensor sits, in the frame of the robot's base (midpoint of the wheel axle, on the ground)."""

    x: float = 0.0
    """Forward of the base [m]."""
    y: float = 0.0
    """Left of the base [m]."""
    z: float = 0.0
    """Above the ground [m]."""
    yaw: float = 0.0
    """Rotation against the base, counter-clockwise [rad]."""
    pitch: float = 0.0
    """Tilt that makes the sensor look down ahead where it is positive [rad]."""
    roll: float = 0.0
    """Tilt that makes it look down to the right where it is positive [rad]."""

    def __post_init__(self) -> None:
        for name in ("pitch", "roll"):
            _require(
                abs(getattr(self, name)) <= MAX_TILT, f"{name} must lie within {MAX_TILT} rad", getattr(self, name)
            )
        self._require_at_most("x", "y", "z", limit=MAX_LENGTH)
        self._require_at_most("yaw")
        _require(self.z > 0.0 or not (self.pitch or self.roll), "a tilted mount must lie above the ground, z", self.z)


@dataclass(frozen=True, slots=True)
class LidarParams(_Params):
    """A 2D lidar."""

    num_beams: int
    """Beams per scan."""
    range_max: float
    """Farthest return [m]."""
    range_min: float = 0.0
    """Nearest return [m]."""
    fov: float = 2.0 * math.pi
    """Field of view, centred on the sensor's x axis [rad]; a full turn does not repeat its first beam."""
    noise_std: float = 0.0
    """Standard deviation of the Gaussian range noise [m]."""
    resolution: float = 0.0
    """Step to which ranges are rounded [m]; 0 for none."""
    dropout: float = 0.0
    """Probability that a beam returns nothing at all."""
    mount: Mount = Mount()

    def __post_init__(self) -> None:
        _require(1 <= self.num_beams <= MAX_BEAMS, f"num_beams must lie in 1 to {MAX_BEAMS:,}", self.num_beams)
        self._require_positive("range_max")
        _require(0 <= self.range_min < self.range_max, "range_min must lie in [0, range_max)", self.range_min)
        _require(0 < self.fov <= 2 * math.pi + 1e-9, "fov must lie in (0, 2 pi]", self.fov)
        self._require_not_negative("noise_std", "resolution")
        _require(0 <= self.dropout < 1, "dropout must lie in [0, 1)", self.dropout)

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


@dataclass(frozen=True, slots=True)
class DriveParams(_Params):
    """Two driven wheels on one axle, as they really are."""

    wheel_radius: float
    """Radius of the driven wheels [m]."""
    track: float
    """Distance between the wheels' contact points [m]."""
    wheel_width: float = 0.02
    """Width of a wheel [m]."""
    wheel_mass: float = 0.1
    """Mass of one wheel [kg]."""
    friction: float = 1.0
    """Coulomb friction between a wheel and the ground."""
    max_torque: float = 1.0
    """Greatest torque that a motor exerts on its wheel [N m]."""
    slip_std: float = 0.0
    """Standard deviation of the distance that a wheel slips while it rolls 1 m [m]; grows with the distance's root. No
    slip moves the robot at more than one and a half times its greatest speed and yaw rate."""

    def __post_init__(self) -> None:
        self._require_positive("wheel_radius", "track", "wheel_width", "wheel_mass", "friction", "max_torque")
        self._require_not_negative("slip_std")
        _require(self.wheel_width < self.track, "wheel_width must be smaller than track", self.wheel_width)


@dataclass(frozen=True, slots=True)
class OdometryNoise(_Params):
    """How far odometry may be off after a motion, as SLAMs weigh it against a scan.

    Standard deviations that grow with the distance d and the turn of the motion, after Thrun, Burgard and Fox,
    Probabilistic Robotics (2005), section 5.4: position_std + position_per_metre d along either axis, and
    heading_std + heading_per_radian |turn| + heading_per_metre d.
    """

    position_std: float = 0.003
    """Of the position, whatever the motion [m]."""
    position_per_metre: float = 0.02
    """Of the position, per distance [m/m]."""
    heading_std: float = 0.003
    """Of the heading, whatever the motion [rad]."""
    heading_per_radian: float = 0.03
    """Of the heading, per turn [rad/rad]."""
    heading_per_metre: float = 0.03
    """Of the heading, per distance [rad/m]."""

    def __post_init__(self) -> None:
        self._require_positive("position_std", "heading_std")
        self._require_not_negative("position_per_metre", "heading_per_radian", "heading_per_metre")


@dataclass(frozen=True, slots=True)
class OdometryParams(_Params):
    """What the robot's own controller takes its wheels for. Where it errs, odometry is biased."""

    wheel_radius: float
    """Wheel radius that the controller assumes [m]."""
    track: float
    """Track that the controller assumes [m]."""
    ticks_per_rev: float
    """Encoder counts in one turn of a wheel."""
    uses_gyro: bool = False
    """Takes turns from the gyroscope, not from the wheels."""
    open_loop: bool = False
    """Counts the commanded steps instead of measured ones (stepper motors without encoders)."""
    noise: OdometryNoise = OdometryNoise()
    """What SLAMs take its errors for."""

    def __post_init__(self) -> None:
        self._require_positive("wheel_radius", "track", "ticks_per_rev")

    @property
    def ticks_per_radian(self) -> float:
        """Encoder counts per radian of a wheel's turn."""
        return self.ticks_per_rev / (2.0 * math.pi)

    @property
    def metres_per_tick(self) -> float:
        """Distance that a wheel rolls in one count [m]."""
        return 2.0 * math.pi * self.wheel_radius / self.ticks_per_rev


@dataclass(frozen=True, slots=True)
class Caster(_Params):
    """A ball that slides under the body, or hangs just above the ground."""

    x: float
    """Forward of the base [m]."""
    y: float
    """Left of the base [m]."""
    radius: float
    """Radius of the ball [m]."""
    clearance: float = 0.0
    """Gap between the ball and the ground while the robot is level [m]."""

    def __post_init__(self) -> None:
        self._require_at_most("x", "y")
        self._require_positive("radius")
        self._require_not_negative("clearance")


@dataclass(frozen=True, slots=True)
class BodyParams(_Params):
    """The rigid body that carries everything, as a box or, where `radius` is given, an upright cylinder."""

    mass: float
    """Mass without the wheels [kg]."""
    center: tuple[float, float, float]
    """Centre of the shape in the base frame, z above the ground [m]."""
    center_of_mass: tuple[float, float, float] | None = None
    """Centre of mass in the base frame, z above the ground [m]; None for the centre of the shape."""
    size: tuple[float, float, float] | None = None
    """Length, width and height of the box [m]."""
    radius: float | None = None
    """Radius of the cylinder [m]."""
    height: float | None = None
    """Height of the cylinder [m]."""
    friction: float = 0.2
    """Coulomb friction between the body and obstacles; 0 for a smooth round body, which walls do not keep from turning
    and which would be turned into them if it rubbed."""

    def __post_init__(self) -> None:
        self._require_positive("mass")
        self._require_not_negative("friction")
        _require((self.size is None) == (self.radius is not None), "give either size or radius and height", self.size)
        _require((self.radius is None) == (self.height is None), "radius and height go together", self.height)
        for value in (*(self.size or ()), self.radius or 1.0, self.height or 1.0):
            _require(0 < value <= MAX_LENGTH, f"dimensions of the body must lie in (0, {MAX_LENGTH:g}] m", value)
        for value in (*self.center, *(self.center_of_mass or ())):
            _require(abs(value) <= MAX_LENGTH, f"positions must lie within {MAX_LENGTH:g} m", value)


@dataclass(frozen=True, slots=True)
class ImuParams(_Params):
    """Gyroscope and compass."""

    gyro_std: float = 0.0
    """Standard deviation of the yaw rate's noise [rad/s]."""
    gyro_bias_std: float = 0.0
    """Standard deviation of the yaw rate's bias, which stays the same from reset to reset [rad/s]."""
    has_compass: bool = False
    """Whether the robot has a compass."""
    compass_std: float = 0.0
    """Standard deviation of the heading [rad]."""
    compass_resolution: float = 0.0
    """Step to which the heading is rounded [rad]; 0 for none."""

    def __post_init__(self) -> None:
        self._require_not_negative("gyro_std", "gyro_bias_std", "compass_std", "compass_resolution")


@dataclass(frozen=True, slots=True)
class RobotParams(_Params):
    """A differential-drive robot."""

    name: str
    """What users call it."""
    radius: float
    """Radius of the circle around the base that is the footprint in planning and in kinematic contact [m]."""
    max_v: float
    """Greatest forward (and backward) speed [m/s]."""
    max_w: float
    """Greatest yaw rate [rad/s]."""
    max_acc_v: float
    """Greatest change of forward speed [m/s2]."""
    max_acc_w: float
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

    def __post_init__(self) -> None:
        self._require_positive("radius", "max_v", "max_w", "max_acc_v", "max_acc_w")
