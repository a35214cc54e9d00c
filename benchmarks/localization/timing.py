"""What an update of AMCL costs, and how that falls as the cloud shrinks."""

import os
import time
from dataclasses import replace

import numpy as np

from envs.geometry import Pose2D
from envs.localization import PRESETS, Amcl
from envs.localization.likelihood_field import LikelihoodField
from envs.localization.motion_model import DifferentialDrive
from envs.localization.resampling import Injection, KldParams, resample

from .drives import Drive, Place, record
from .runs import START_STD

REPEATS = 5
"""Times that a drive is timed; the median of the repeats' medians is reported."""


def _see_far(place: Place) -> Place:
    """Give the robot a lidar that reaches across the place, so that every beam returns and has to be weighed."""
    return replace(place, robot=replace(place.robot, lidar=replace(place.robot.lidar, range_max=15.0)))


def _median_update(place: Place, drive: Drive, particles: int, sensor: str) -> float:
    """Return the median time of a whole `update` that uses its scan [us]."""
    params = replace(
        PRESETS["nav2"],
        min_particles=particles,
        max_particles=particles,
        sensor=sensor,
        update_min_d=0.0,
        update_min_a=0.0,
    )
    amcl = Amcl(place.robot.lidar, params)
    covariance = np.diag(np.square(START_STD))
    amcl.reset(place.grid, Pose2D(*drive.truth[0]), np.random.default_rng(0), covariance=covariance)
    steps = [(ranges, Pose2D(*motion)) for ranges, motion in zip(drive.ranges, drive.motions.tolist())]
    spent = []
    for ranges, motion in steps:
        begin = time.perf_counter()
        amcl.update(ranges, motion)
        spent.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(spent[20:]))


def _median_steps(place: Place, drive: Drive, particles: int, sensor: str) -> float:
    """Return the median time of moving, weighing and drawing particles alone [us], without what the estimate costs."""
    params = replace(PRESETS["nav2"], min_particles=particles, max_particles=particles, sensor=sensor)
    move, weigh = DifferentialDrive(params), LikelihoodField(params, place.robot.lidar, place.grid)
    rng = np.random.default_rng(0)
    cloud = (drive.truth[0] + START_STD * rng.standard_normal((particles, 3))).T.astype(np.float32).copy()
    other, none = np.empty_like(cloud), Injection(np.empty((3, 1), dtype=np.float32), 0.0)
    bins, seen, kld = np.zeros(particles, dtype=np.int32), np.zeros(1, dtype=bool), KldParams(particles, 0.05, 0.99)
    spent = []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        begin = time.perf_counter()
        move(Pose2D(*motion))(cloud, rng)
        weights = np.full(particles, 1.0 / particles)
        weigher = weigh(ranges)
        assert weigher is not None
        weigher(cloud, weights)
        weights /= weights.sum()
        resample(cloud, weights, bins, none, rng.random(), kld, seen, other)
        cloud, other = other, cloud
        spent.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(spent[20:]))


def update_times(place: Place) -> dict[str, float]:
    """Time a fixed number of particles with 60 beams, pinned to one core, side by side [us].

    Whole updates, with the estimate, its covariance and the check against the map; and their steps move, weigh, draw.
    """
    place = _see_far(place)
    drive = record(place, np.random.SeedSequence(0), 30.0, "kinematic")
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    if cores is not None:
        os.sched_setaffinity(0, {min(cores)})
    cases = [(n, sensor) for n in (1000, 2000) for sensor in ("likelihood_field", "likelihood_field_prob")]
    spent: dict[str, list[float]] = {}
    for _ in range(REPEATS):
        for n, sensor in cases:
            for what, measure in (("update", _median_update), ("move, weigh, draw", _median_steps)):
                spent.setdefault(f"{n} x 60 {sensor}, {what}", []).append(measure(place, drive, n, sensor))
    if cores is not None:
        os.sched_setaffinity(0, cores)
    return {f"{name} [us]": float(np.median(times)) for name, times in spent.items()}


def cost_by_size(place: Place, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time the updates of the default preset from waking up anywhere to having found itself.

    Returns:
        For each scan that was used: when it was taken [s], particles that were weighed, and time of the update [us].
    """
    drive = record(place, np.random.SeedSequence(seed), 30.0, "kinematic")
    amcl = Amcl(place.robot.lidar, PRESETS["default"])
    rows = []
    for repeat in range(2):  # the first compiles
        amcl.reset(place.grid, None, np.random.default_rng(seed))
        rows.clear()
        for k, (ranges, motion) in enumerate(zip(drive.ranges, drive.motions.tolist())):
            weighed = amcl.num_particles
            begin = time.perf_counter()
            estimate = amcl.update(ranges, Pose2D(*motion))
            spent = time.perf_counter() - begin
            if estimate.is_corrected and repeat:
                rows.append((0.1 * k, weighed, 1e6 * spent))
    when, sizes, spent_us = np.array(rows).T
    return when, sizes, spent_us
