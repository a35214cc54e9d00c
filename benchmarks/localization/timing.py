"""Time of AMCL's updates, and how it falls with the number of particles."""

import itertools
import os
import time
from dataclasses import replace

import numpy as np

from benchmarks.recorded_drives import PERIOD, Drive
from envs.geometry import OccupancyGrid, Pose2D
from envs.localization import PRESETS, Amcl, AmclParams
from envs.localization.likelihood_field import LikelihoodField
from envs.localization.motion_model import move_particles
from envs.localization.resampling import resample
from envs.robots import LidarParams

from .maps import KnownWorld, record_from_anywhere
from .runs import START_STD, localize

REPEATS = 5
"""Number of repetitions; the median of their medians is reported."""


def _median_update(grid: OccupancyGrid, lidar: LidarParams, drive: Drive, params: AmclParams) -> float:
    """Return the median time of whole updates that use their scans [us]."""
    params = replace(params, update_min_d=0.0, update_min_a=0.0)
    track = localize(Amcl(lidar, params), grid, drive, 0, START_STD)
    return 1e6 * float(np.median(track.seconds[20:]))


def _median_steps(grid: OccupancyGrid, lidar: LidarParams, drive: Drive, params: AmclParams) -> float:
    """Return the median time of propagating, weighting and resampling alone [us], without the estimate."""
    weigh, particles = LikelihoodField(params, lidar, grid), params.max_particles
    rng = np.random.default_rng(0)
    cloud = (drive.truth[0] + START_STD * rng.standard_normal((particles, 3))).T.astype(np.float32).copy()
    other, none = np.empty_like(cloud), np.empty((3, 0), dtype=np.float32)
    bins, seen, kld = np.zeros(particles, dtype=np.int32), np.zeros(1, dtype=bool), (particles, 0.05, 0.99)
    spent = []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        begin = time.perf_counter()
        move_particles(cloud, Pose2D(*motion), params, rng)
        weights = np.full(particles, 1.0 / particles)
        weigher = weigh(ranges)
        assert weigher is not None
        weigher(cloud, weights)
        weights /= weights.sum()
        resample(cloud, weights, bins, rng.random(), kld, none, 0.0, seen, other)
        cloud, other = other, cloud
        spent.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(spent[20:]))


def update_times(known: KnownWorld) -> dict[str, float]:
    """Time whole updates and their steps for fixed numbers of particles and 60 beams, pinned to one core [us].

    The lidar gets a range of 15 m, so that every beam returns.
    """
    lidar = replace(known.setup.robot.lidar, range_max=15.0)
    setup = known.setup._replace(robot=replace(known.setup.robot, lidar=lidar))
    drive = record_from_anywhere(setup, np.random.SeedSequence(0), 30.0)
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    if cores is not None:
        os.sched_setaffinity(0, {min(cores)})
    spent: dict[str, list[float]] = {}
    for _ in range(REPEATS):
        for n, sensor in itertools.product((1000, 2000), ("likelihood_field", "likelihood_field_prob")):
            params = replace(PRESETS["nav2"], min_particles=n, max_particles=n, sensor=sensor)
            for what, measure in (("update", _median_update), ("propagate, reweight, resample", _median_steps)):
                time_us = measure(known.grid, lidar, drive, params)
                spent.setdefault(f"{n} x 60 {sensor}, {what}", []).append(time_us)
    if cores is not None:
        os.sched_setaffinity(0, cores)
    return {f"{name} [us]": float(np.median(times)) for name, times in spent.items()}


def cost_by_size(known: KnownWorld, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time the updates of the default preset during global localization.

    Returns:
        For each scan that was used: its time [s], the number of particles that were weighted, and the time of the
        update [us].
    """
    drive = record_from_anywhere(known.setup, np.random.SeedSequence(seed), 30.0)
    params = PRESETS["default"]
    amcl = Amcl(known.setup.robot.lidar, params)
    localize(amcl, known.grid, drive, seed, None)  # compiles the kernels
    track = localize(amcl, known.grid, drive, seed, None)
    weighted = np.concatenate([[params.most_particles], track.num_particles[:-1]])
    used = track.is_corrected
    return PERIOD * np.flatnonzero(used), weighted[used], 1e6 * track.seconds[used]
