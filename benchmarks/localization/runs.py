"""AMCL along recorded drives, and one run of each experiment: tracking, global localization, kidnapped robot."""

import math
import time
from typing import NamedTuple

import numpy as np

from benchmarks.recorded_drives import PERIOD, Drive
from envs.geometry import OccupancyGrid, Pose2D
from envs.localization import Amcl, load_preset
from envs.logs import pose_errors, rms
from envs.simulation import Reading

from .maps import load_known_world, record_from_anywhere, symmetries

TRACKING_TIME = 60.0
"""Length of the drives for pose tracking and global localization [s]."""
KIDNAPPED_AT = 20.0
"""When a robot is kidnapped [s]."""
RECOVERY_TIME = 90.0
"""Length of the drive after that [s]."""
NEAR = 0.5
"""Greatest error of a correct estimate's position [m]."""
NEAR_ANGLE = math.radians(20.0)
"""Greatest error of its heading [rad]."""
HOLD = 5.0
"""A robot is localized if its estimate is correct for this long at the end [s]."""
START_STD = (0.05, 0.05, 0.05)
"""Standard deviations of the initial pose [m, m, rad]."""


class Track(NamedTuple):
    """Estimates at the n scans of a drive, all of shape (n, ...)."""

    poses: np.ndarray
    """Shape (n, 3), float64: estimated poses [m, rad]."""
    is_lost: np.ndarray
    """Whether the filter called itself lost."""
    fit: np.ndarray
    """Share of hits that the map explains."""
    is_corrected: np.ndarray
    num_particles: np.ndarray
    seconds: np.ndarray
    """Time of the update [s]."""


def localize(
    amcl: Amcl, grid: OccupancyGrid, drive: Drive, seed: int, start_std: tuple[float, float, float] | None
) -> Track:
    """Localize along a drive.

    Args:
        amcl: the filter; it is reset.
        grid: the map.
        drive: the recorded drive.
        seed: of the filter's noise.
        start_std: standard deviations of the initial pose, which is the true one [m, m, rad]; None for global
            localization.
    """
    start = None if start_std is None else Pose2D(*drive.truth[0].tolist())
    covariance = None if start_std is None else np.diag(np.square(start_std))
    amcl.reset(np.random.default_rng(seed), start, grid, covariance)
    rows = []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        begin = time.perf_counter()
        belief = amcl.update(Reading.of_scan(ranges), Pose2D(*motion))
        seconds = time.perf_counter() - begin
        rows.append((belief.pose, belief.is_lost, amcl.fit, amcl.is_corrected, amcl.num_particles, seconds))
    return Track(*map(np.array, zip(*rows)))


class Run(NamedTuple):
    """Results of one seed, or columns of the results of many; times are infinite for never."""

    position: float
    """Pose tracking: root mean square error of the position [m]."""
    heading: float
    """Pose tracking: root mean square error of the heading [deg]."""
    found: bool
    """Whether global localization succeeded."""
    found_up_to_symmetry: bool
    """Whether it did so up to a rotation of the map onto itself."""
    found_after: float
    """Time from which on the estimate was correct [s]."""
    recovered: bool
    """Whether the kidnapped robot was localized again."""
    recovered_after: float
    """Time after the kidnapping from which on the estimate was correct [s]."""
    noticed_after: float
    """Time after the kidnapping at which the filter first called itself lost [s]."""
    confident_and_wrong: float
    """Share of the time of these two experiments with a wrong estimate by a filter that did not call itself lost."""
    lost_while_right: float
    """Share of the time of pose tracking in which the filter called itself lost though its estimate was correct."""


def _is_right(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    distance, angle = pose_errors(poses, truth)
    return (distance <= NEAR) & (angle <= NEAR_ANGLE)


def _is_localized(is_right: np.ndarray) -> bool:
    return bool(is_right[-round(HOLD / PERIOD) :].all())


def time_of_success(is_right: np.ndarray) -> float:
    """Return the time from which on an estimate was correct [s]; inf if it was not so for long enough."""
    if not _is_localized(is_right):
        return math.inf
    wrong = np.flatnonzero(~is_right)
    return float(wrong[-1] + 1) * PERIOD if len(wrong) else 0.0


def run(world: str, preset: str, physics: str, seed: int) -> Run:
    """Do all three experiments with one seed."""
    known = load_known_world(world, physics)
    first, second = np.random.SeedSequence(seed).spawn(2)
    drive = record_from_anywhere(known.setup, first, TRACKING_TIME)
    elsewhere = record_from_anywhere(known.setup, second, RECOVERY_TIME)
    amcl = Amcl(known.setup.robot.lidar, load_preset(preset))

    tracked = localize(amcl, known.grid, drive, seed, START_STD)
    distance, angle = pose_errors(tracked.poses, drive.truth)
    lost_while_right = tracked.is_lost & _is_right(tracked.poses, drive.truth)

    found = localize(amcl, known.grid, drive, seed, None)
    is_right = _is_right(found.poses, drive.truth)
    motions = symmetries(known.grid)
    turned = [np.array([motion.compose(Pose2D(*pose)) for pose in drive.truth.tolist()]) for motion in motions]

    scans = round(KIDNAPPED_AT / PERIOD)
    kidnapped = drive.then(elsewhere, scans)
    recovered = localize(amcl, known.grid, kidnapped, seed, START_STD)
    is_right_again = _is_right(recovered.poses, kidnapped.truth)[scans:]
    is_lost_again = recovered.is_lost[scans:]
    wrong = np.concatenate([~is_right & ~found.is_lost, ~is_right_again & ~is_lost_again])
    return Run(
        position=rms(distance),
        heading=math.degrees(rms(angle)),
        found=_is_localized(is_right),
        found_up_to_symmetry=any(_is_localized(_is_right(found.poses, truth)) for truth in (drive.truth, *turned)),
        found_after=time_of_success(is_right),
        recovered=_is_localized(is_right_again),
        recovered_after=time_of_success(is_right_again),
        noticed_after=float(np.argmax(is_lost_again)) * PERIOD if is_lost_again.any() else math.inf,
        confident_and_wrong=float(np.mean(wrong)),
        lost_while_right=float(np.mean(lost_while_right)),
    )
