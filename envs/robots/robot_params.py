"""Robot parameters as Pydantic dataclasses."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from lidarnaut.envs.files.field_help import Record, document_fields

MAX_NUMBER = 1e9
"""Default upper limit of numeric robot parameters, in SI units."""
MAX_LENGTH = 100.0
"""Upper limit of body dimensions and of coordinates in the base frame [m]."""
MAX_TILT = 0.35
"""Maximum pitch and roll of a mounted lidar [rad]."""
MAX_BEAMS = 20_000
MAX_STOPPING_DISTANCE = 1000.0
"""Upper limit of the braking distance from full speed [m]; paths are tested that far ahead."""
MAX_ODOMETRY_FACTOR = 2.0
"""Upper limit of the factor between true and assumed dimensions of the drive, in either direction."""

Positive = Annotated[float, Field(gt=0.0, le=MAX_NUMBER)]
NotNegative = Annotated[float, Field(ge=0.0, le=MAX_NUMBER)]
Side = Annotated[float, Field(gt=0.0, le=MAX_LENGTH)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH, le=MAX_LENGTH)]
Tilt = Annotated[float, Field(ge=-MAX_TILT, le=MAX_TILT)]
Angle = Annotated[float, Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1)]
NoReturn = Literal["inf", "zero"]
CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True, config=CONFIG)
class Mount(metaclass=Record):
    """Sensor pose in the robot's base frame, with origin on the ground below the midpoint of the wheel axle."""

    x: Coordinate = 0.0
    """Forward position of the sensor [m]."""
    y: Coordinate = 0.0
    """Leftward position of the sensor [m]."""
    z: Coordinate = 0.0
    """Height of the sensor above the ground [m]."""
    yaw: Angle = 0.0
    """Yaw of the sensor, counter-clockwise [rad]."""
    pitch: Tilt = 0.0
    """Pitch of the sensor [rad]. Positive values tilt the forward view downwards."""
    roll: Tilt = 0.0
    """Roll of the sensor [rad]. Positive values tilt the view to the right downwards."""

    def __post_init__(self) -> None:
        if (self.pitch or self.roll) and self.z <= 0.0:
            raise ValueError(f"a tilted mount must lie above the ground, got z = {self.z}")


@dataclass(frozen=True, slots=True, config=CONFIG)
class LidarParams(metaclass=Record):
    """Parameters of a 2D lidar."""

    num_beams: Annotated[int, Field(ge=1, le=MAX_BEAMS)]
    """Number of beams per scan."""
    range_max: Positive
    """Maximum range [m]."""
    range_min: NotNegative = 0.0
    """Minimum range [m]."""
    fov: Annotated[float, Field(gt=0.0, le=2.0 * math.pi + 1e-9)] = 2.0 * math.pi
    """Field of view, centred on the sensor's x axis [rad]. A full turn does not repeat the first beam."""
    noise_std: NotNegative = 0.0
    """Standard deviation of the Gaussian range noise [m]."""
    resolution: NotNegative = 0.0
    """Range resolution (rounding step) [m]; 0 for no rounding."""
    dropout: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Probability that a beam returns no measurement."""
    mount: Mount = Mount()
    """Pose of the lidar in the base frame."""
    scan_time: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Time of a full turn of the simulated lidar, whose beams are measured one after the other, counter-clockwise [s].
    Scans are deskewed by odometry, and end at the end of the control period; 0 for all beams at once."""
    no_return: NoReturn = "inf"
    """Meaning of ranges of 0.0 in logs and messages of the real lidar: `zero` for no return, as the LDS-01 reports it;
    `inf` for an invalid beam, if no return is inf or above `range_max` (REP 117)."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_rate(cls, given: Any) -> Any:
        keys = getattr(given, "kwargs", given)
        if isinstance(keys, Mapping) and "rate" in keys:
            raise ValueError("there is no key 'rate': a lidar scans once per control period, see control_hz")
        return given

    def __post_init__(self) -> None:
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min must be less than range_max, got {self.range_min} and {self.range_max}")

    @property
    def angle_increment(self) -> float:
        full_turn = self.fov > 2 * math.pi - 1e-6
        return self.fov / (self.num_beams if full_turn else max(self.num_beams - 1, 1))

    @property
    def angle_min(self) -> float:
        """Angle of the first beam in the sensor frame [rad]."""
        return -self.fov / 2 if self.num_beams > 1 else 0.0

    @property
    def time_increment(self) -> float:
        """Time between successive beams [s]; 0 if all are measured at once."""
        return self.scan_time * self.angle_increment / (2.0 * math.pi)

    @property
    def angles(self) -> np.ndarray:
        """Angles of the beams in the sensor frame, shape (num_beams,), float64 [rad]."""
        return self.angle_min + np.arange(self.num_beams) * self.angle_increment

    @property
    def directions(self) -> np.ndarray:
        """Cosines and sines of the beam angles in the base frame, shape (2, num_beams), float64."""
        angles = self.angles + self.mount.yaw
        return np.stack([np.cos(angles), np.sin(angles)])


@dataclass(frozen=True, slots=True, config=CONFIG)
class DriveParams(metaclass=Record):
    """True parameters of the drive. The controller may assume other values, see `OdometryParams`."""

    wheel_radius: Positive
    """True radius of the driven wheels [m]."""
    track: Positive
    """True distance between the contact points of the driven wheels [m]."""
    wheel_width: Positive = 0.02
    """Width of a driven wheel [m]."""
    wheel_mass: Positive = 0.1
    """Mass of a driven wheel [kg]."""
    friction: Positive = 1.0
    """Coulomb friction coefficient between wheel and ground."""
    max_torque: Positive = 1.0
    """Maximum torque of a wheel motor [N m]."""
    slip_std: NotNegative = 0.0
    """Standard deviation of wheel slip after 1 m of rolling [m]. In a control period, a wheel that rolls a distance d
    moves by `slip_std * sqrt(d / (1 m)) * n` more, with a standard normal number n; encoders do not measure slip."""

    def __post_init__(self) -> None:
        if self.wheel_width >= self.track:
            raise ValueError(f"wheel_width must be smaller than track, got {self.wheel_width} and {self.track}")


@dataclass(frozen=True, slots=True, config=CONFIG)
class OdometryNoise(metaclass=Record):
    """Odometry noise model for SLAM: standard deviations of the pose error between two processed scans.

    After Thrun, Burgard and Fox, Probabilistic Robotics (2005), section 5.4: `position_std + position_per_metre *
    distance` along each axis, and `heading_std + heading_per_radian * |turn| + heading_per_metre * distance`.
    """

    position_std: Positive = 0.003
    """Constant term of the position error's standard deviation between two processed scans [m]; a term for distance is
    added."""
    position_per_metre: NotNegative = 0.02
    """Standard deviation of the position error per driven metre [m/m]."""
    heading_std: Positive = 0.003
    """Constant term of the heading error's standard deviation between two processed scans [rad]; terms for turn and
    distance are added."""
    heading_per_radian: NotNegative = 0.03
    """Standard deviation of the heading error per radian of turning [rad/rad]."""
    heading_per_metre: NotNegative = 0.03
    """Standard deviation of the heading error per driven metre [rad/m]."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class OdometryParams(metaclass=Record):
    """Drive parameters that the robot's controller assumes. Deviations from the true values bias odometry."""

    wheel_radius: Positive
    """Wheel radius that the controller assumes [m]."""
    track: Positive
    """Wheel separation that the controller assumes [m]."""
    ticks_per_rev: Positive
    """Encoder counts per wheel revolution."""
    uses_gyro: bool = False
    """Whether odometry measures turns with the gyroscope instead of the wheels."""
    open_loop: bool = False
    """Whether odometry counts commanded instead of measured motor steps (stepper motors without encoders)."""
    noise: OdometryNoise = OdometryNoise()
    """Odometry noise model for SLAM."""

    @property
    def ticks_per_radian(self) -> float:
        return self.ticks_per_rev / (2.0 * math.pi)

    @property
    def metres_per_tick(self) -> float:
        return 2.0 * math.pi * self.wheel_radius / self.ticks_per_rev


@dataclass(frozen=True, slots=True, config=CONFIG)
class Caster(metaclass=Record):
    """Frictionless caster ball under the body, on or just above the ground."""

    x: Coordinate
    """Forward position in the base frame [m]."""
    y: Coordinate
    """Leftward position in the base frame [m]."""
    radius: Positive
    """Radius of the caster ball [m]."""
    clearance: NotNegative = 0.0
    """Gap between caster and ground when the robot is level [m]."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class BodyParams(metaclass=Record):
    """Rigid body of the robot: a box, or an upright cylinder if `radius` is given."""

    mass: Positive
    """Mass of the robot without its wheels [kg]."""
    center: tuple[Coordinate, Coordinate, Coordinate]
    """Centre of the shape (x, y, z) in the base frame [m]."""
    center_of_mass: tuple[Coordinate, Coordinate, Coordinate] | None = None
    """Centre of mass (x, y, z) in the base frame [m]; None for `center`."""
    size: tuple[Side, Side, Side] | None = None
    """Length, width and height of the box [m]."""
    radius: Side | None = None
    """Radius of the cylinder [m]."""
    height: Side | None = None
    """Height of the cylinder [m]."""
    friction: NotNegative = 0.2
    """Coulomb friction coefficient between body and obstacles."""

    def __post_init__(self) -> None:
        if (self.size is None, self.radius is None) != (self.height is not None, self.height is None):
            values = f"size {self.size}, radius {self.radius}, height {self.height}"
            raise ValueError(f"give either size or radius and height, got {values}")

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Moments of inertia about the axes of the homogeneous shape [kg m2]."""
        if self.size is not None:
            x, y, z = (self.mass * side**2 / 12.0 for side in self.size)
            return y + z, x + z, x + y
        radius, height = self.radius or 0.0, self.height or 0.0
        across = self.mass * (3.0 * radius**2 + height**2) / 12.0
        return across, across, 0.5 * self.mass * radius**2


@dataclass(frozen=True, slots=True, config=CONFIG)
class ImuParams(metaclass=Record):
    """Parameters of gyroscope and compass."""

    gyro_std: NotNegative = 0.0
    """Standard deviation of the gyroscope noise, independent in each control period [rad/s]."""
    gyro_bias_std: NotNegative = 0.0
    """Standard deviation of the gyroscope bias, which is constant during an episode [rad/s]."""
    has_compass: bool = False
    """Whether the robot has a compass."""
    compass_std: NotNegative = 0.0
    """Standard deviation of the compass noise [rad], independent in each control period."""
    compass_offset: Angle = 0.0
    """Constant error of the compass, such as that of its mounting [rad]."""
    compass_deviation: NotNegative = 0.0
    """Amplitude A of the compass deviation, the error A sin(heading - phase) by magnetic parts of the robot (hard iron)
    [rad]. Magnetic sources of the world are in its world file (`magnets`)."""
    compass_deviation_phase: Angle = 0.0
    """Heading in the world frame without deviation [rad]."""
    compass_resolution: NotNegative = 0.0
    """Compass resolution (rounding step) [rad]; 0 for no rounding."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class BatteryParams(metaclass=Record):
    """Parameters of the battery, for docking tasks; the defaults are those of a Tugbot."""

    capacity: Positive = 29.5
    """Energy of the full battery [W h]."""
    idle_power: NotNegative = 6.5
    """Power of computer and sensors [W]."""
    energy_per_metre: NotNegative = 15.0
    """Energy of the motors per driven metre [J/m]."""
    charging_power: Positive = 9.8
    """Power of the charging station [W]."""


@dataclass(frozen=True, slots=True, config=CONFIG)
class RobotParams(metaclass=Record):
    """Parameters of a differential-drive robot."""

    name: str
    """Name of the robot in messages and tables."""
    radius: Positive
    """Radius of the circular footprint around the base, for planning and kinematic contact [m]."""
    max_v: Positive
    """Maximum forward and backward speed [m/s]."""
    max_w: Positive
    """Maximum yaw rate [rad/s]."""
    max_acc_v: Positive
    """Maximum forward acceleration and deceleration [m/s2]."""
    max_acc_w: Positive
    """Maximum yaw acceleration [rad/s2]."""
    drive: DriveParams
    """True parameters of the drive."""
    odometry: OdometryParams
    """Drive parameters assumed by the controller."""
    body: BodyParams
    """Rigid body: a box, or an upright cylinder."""
    lidar: LidarParams
    """2D lidar, which scans once per control period."""
    casters: tuple[Caster, ...] = ()
    """Caster balls under the body."""
    imu: ImuParams = ImuParams()
    """Gyroscope and compass."""
    battery: BatteryParams = BatteryParams()
    """Battery, for docking tasks."""
    source: str = ""
    """Sources of the parameter values."""

    def __post_init__(self) -> None:
        stop = 0.5 * self.max_v**2 / self.max_acc_v
        if stop > MAX_STOPPING_DISTANCE:
            speeds = f"max_v {self.max_v:g} m/s and max_acc_v {self.max_acc_v:g} m/s2"
            raise ValueError(
                f"{speeds} give a stopping distance of {stop:.3g} m, allowed are {MAX_STOPPING_DISTANCE:g}"
            )
        for name in ("wheel_radius", "track"):
            assumed, true = getattr(self.odometry, name), getattr(self.drive, name)
            if not 1.0 / MAX_ODOMETRY_FACTOR <= assumed / true <= MAX_ODOMETRY_FACTOR:
                sizes = f"odometry.{name} is {assumed:g} m and drive.{name} {true:g} m"
                raise ValueError(f"{sizes}: allowed is a factor of {MAX_ODOMETRY_FACTOR:g}")


document_fields(__name__)
