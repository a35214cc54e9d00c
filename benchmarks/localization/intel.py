"""AMCL on the log of a real robot, on a map made from the log's reference poses."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.recorded_drives import Drive
from envs.geometry import OCCUPIED, OccupancyGrid, Pose2D
from envs.localization import PRESETS, Amcl, AmclParams
from envs.logs import Log, load_log, pose_errors, rms
from envs.robots import LidarParams
from envs.simulation import Reading
from envs.slam import KnownPoses, TinySlamParams

from .runs import localize

SHARE_OF_HITS = 16
"""A cell is occupied from this share of hits among all that beams say of it [percent]: what log odds make of 0.9 for a
hit and 0.4 for a pass, as Hector has them."""
MAP = TinySlamParams(
    resolution=0.05,
    map_width=60.0,
    map_height=60.0,
    hole_width=0.0,
    occupied_prob=1.0,
    empty_prob=0.0,
    quality=1.0,
    raw_quality=1.0,
    skip_exceeding=True,
)
"""Cells that count hits and passes."""
NAV2_PROB = replace(PRESETS["nav2"], sensor="likelihood_field_prob")
FILTERS = {
    "nav2 likelihood_field": PRESETS["nav2"],
    "nav2 likelihood_field_prob": NAV2_PROB,
    "nav2 likelihood_field_prob, 2000 particles": replace(NAV2_PROB, min_particles=2000),
    "nav2 beam": replace(PRESETS["nav2"], sensor="beam", max_range=30.0),
    "default": replace(PRESETS["default"], relocalize=False),
    "default, 2000 particles, all beams": replace(
        PRESETS["default"], min_particles=2000, max_beams=180, squash=9.0, relocalize=False
    ),
}
"""Filters that are compared, without relocalization, so that no error is hidden."""
START_STD = (0.1, 0.1, 0.05)
"""Standard deviations of the pose at the start [m, m, rad]."""


def reference_map(log: Log, reference: np.ndarray) -> OccupancyGrid:
    """Draw a log at reference poses, shape (m, 3) [m, rad], seen from the first one, which becomes the origin."""
    mapper = KnownPoses(log.lidar, MAP)
    mapper.reset(np.random.default_rng(0))
    before = Pose2D(0.0, 0.0, 0.0)
    for ranges, row in zip(log.ranges, reference.tolist()):
        pose = Pose2D(*row)
        mapper.update(Reading.of_scan(ranges), before.between(pose))
        before = pose
    grid = mapper.belief.grid
    data = np.where(grid.data >= SHARE_OF_HITS, OCCUPIED, np.minimum(grid.data, 0)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


def measure_filter(
    drive: Drive, lidar: LidarParams, grid: OccupancyGrid, params: AmclParams, seed: int
) -> dict[str, float]:
    """Track the robot of a log along its raw odometry from the first reference pose on, on a map in their frame.

    Returns errors over all scans against the reference, time of an update and number of particles.
    """
    track = localize(Amcl(lidar, params), grid, drive, seed, START_STD)
    distance, angle = pose_errors(track.poses, drive.truth)
    return {
        "position_rmse_m": rms(distance),
        "position_median_m": float(np.median(distance)),
        "position_max_m": float(distance.max()),
        "heading_rmse_deg": math.degrees(rms(angle)),
        "update_us": 1e6 * float(np.median(track.seconds[track.is_corrected])),
        "particles": float(np.mean(track.num_particles[track.is_corrected])),
        "lost_share": float(np.mean(track.is_lost)),
    }


def load_reference(path: Path, num_scans: int | None = None) -> tuple[Log, Drive]:
    """Read the first scans of a log, None for all, with their reference poses, which begin at the origin.

    The log's arrays also hold the reference, `corr`.
    """
    log = load_log(path)
    log = replace(log, scan_rows=log.scan_rows[:num_scans], ranges=log.ranges[:num_scans])
    with np.load(path) as arrays:
        corrected = arrays["corr"][log.scan_rows]
    origin = Pose2D(*corrected[0])
    reference = np.array([origin.between(Pose2D(*row)) for row in corrected.tolist()])
    return log, Drive(log.ranges, np.array(list(log.motions())), reference)


def measure(path: Path, seeds: range) -> dict[str, dict[str, float]]:
    """Compare filters on a log, see `load_reference`: medians over seeds, by filter."""
    log, drive = load_reference(path)
    grid = reference_map(log, drive.truth)
    results = {}
    for name, params in FILTERS.items():
        few = seeds[:1] if params.sensor == "beam" else seeds
        runs = [measure_filter(drive, log.lidar, grid, params, seed) for seed in few]
        results[name] = {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
    return results
