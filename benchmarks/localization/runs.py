"""One run of each experiment: tracking, waking up anywhere, being carried off."""

import math
from dataclasses import dataclass

import numpy as np

from envs.geometry import Pose2D
from envs.localization import Amcl, AmclParams

from .drives import PERIOD, Drive, Place, record

TRACKING_TIME = 60.0
"""How long a robot is tracked, and how long one that wakes up anywhere has to find itself [s]."""
CARRIED_OFF_AT = 20.0
"""When a robot is carried off [s]."""
RECOVERY_TIME = 90.0
"""How long it then has to find itself [s]."""
NEAR = 0.5
"""An estimate is right if it is at most this far off [m]..."""
NEAR_ANGLE = math.radians(20.0)
"""... and turned by this much [rad]."""
HOLD = 5.0
"""A robot has found itself if its estimate has been right for this long at the end [s]."""
START_STD = (0.05, 0.05, 0.05)
"""Standard deviations of the pose that a tracked robot is started with [m, m, rad]."""


@dataclass(frozen=True, slots=True)
class Run:
    """What came of one seed."""

    position: float
    """Tracking: root mean square error of the position [m]."""
    heading: float
    """Tracking: root mean square error of the heading [deg]."""
    found: bool
    """Whether the robot that woke up anywhere found itself."""
    found_up_to_symmetry: bool
    """The same where a turn of the map onto itself does not count as an error."""
    found_after: float
    """When its estimate was wrong last [s]."""
    recovered: bool
    """Whether the robot that was carried off found itself again."""
    recovered_after: float
    """When its estimate was wrong last, from then on [s]."""
    noticed_after: float
    """When it first said that it is lost, from then on [s]; inf if it never did though it was."""
    confident_and_wrong: float
    """Share of the time of these two experiments in which the estimate was wrong and did not say so."""
    lost_while_right: float
    """Share of the time of tracking in which it called itself lost."""


def follow(
    localizer: Amcl, place: Place, drive: Drive, seed: int, start: Pose2D | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Localise along a drive.

    Args:
        localizer: is reset.
        place: gives the map.
        drive: what was recorded.
        seed: of the filter's noise.
        start: where the robot is told to be; None for anywhere.

    Returns:
        Estimated poses, shape (n, 3), float64, whether it called itself lost, shape (n,), bool, and its number of
        particles, shape (n,), int64.
    """
    covariance = None if start is None else np.diag(np.square(START_STD))
    localizer.reset(place.grid, start, np.random.default_rng(seed), covariance=covariance)
    poses, lost, counts = [], [], []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        estimate = localizer.update(ranges, Pose2D(*motion))
        poses.append(estimate.pose)
        lost.append(estimate.is_lost)
        counts.append(localizer.num_particles)
    return np.array(poses), np.array(lost), np.array(counts)


def errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances [m] and angles [rad] between poses, both of shape (n, 3): two arrays of shape (n,)."""
    turned = (poses[:, 2] - truth[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return np.hypot(*(poses - truth)[:, :2].T), np.abs(turned)


def _right(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    distance, angle = errors(poses, truth)
    return (distance <= NEAR) & (angle <= NEAR_ANGLE)


def _last_wrong(right: np.ndarray) -> float:
    """Return when an estimate was wrong last [s]."""
    wrong = np.flatnonzero(~right)
    return float(wrong[-1] + 1) * PERIOD if len(wrong) else 0.0


def run(place: Place, symmetries: list[Pose2D], params: AmclParams, seed: int, physics: str) -> Run:
    """Do all three experiments with one seed."""
    first, second = np.random.SeedSequence(seed).spawn(2)
    drive = record(place, first, TRACKING_TIME, physics)
    elsewhere = record(place, second, RECOVERY_TIME, physics)
    localizer = Amcl(place.robot.lidar, params)

    poses, lost, _ = follow(localizer, place, drive, seed, Pose2D(*drive.truth[0]))
    distance, angle = errors(poses, drive.truth)
    lost_while_right = float(np.mean(lost & _right(poses, drive.truth)))

    hold = round(HOLD / PERIOD)
    poses, lost, _ = follow(localizer, place, drive, seed, None)
    right = _right(poses, drive.truth)
    turned = [np.array([motion.compose(Pose2D(*pose)) for pose in drive.truth.tolist()]) for motion in symmetries]
    found_up_to_symmetry = any(_right(poses, truth)[-hold:].all() for truth in (drive.truth, *turned))
    unaware = [~right & ~lost]

    scans = round(CARRIED_OFF_AT / PERIOD)
    carried = drive.then(elsewhere, scans)
    poses, lost, _ = follow(localizer, place, carried, seed, Pose2D(*drive.truth[0]))
    right_again, lost_again = _right(poses, carried.truth)[scans:], lost[scans:]
    unaware.append(~right_again & ~lost_again)
    noticed = np.flatnonzero(lost_again)
    return Run(
        position=float(np.sqrt(np.mean(distance**2))),
        heading=math.degrees(float(np.sqrt(np.mean(angle**2)))),
        found=bool(right[-hold:].all()),
        found_up_to_symmetry=bool(found_up_to_symmetry),
        found_after=_last_wrong(right),
        recovered=bool(right_again[-hold:].all()),
        recovered_after=_last_wrong(right_again),
        noticed_after=float(noticed[0]) * PERIOD if len(noticed) else math.inf,
        confident_and_wrong=float(np.mean(np.concatenate(unaware))),
        lost_while_right=lost_while_right,
    )
