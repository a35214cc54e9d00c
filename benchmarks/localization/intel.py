"""AMCL on the log of a real robot, on a map made from the log's reference poses."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from envs.geometry import OCCUPIED, OccupancyGrid, Pose2D
from envs.localization import PRESETS, Amcl, AmclParams
from envs.logs import Log, load_log
from envs.slam import GivenPoseSlam, TinySlamParams

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
"""Filters that are compared. None may start over, so that no error is hidden."""
START_STD = (0.1, 0.1, 0.05)
"""Standard deviations of the pose at the start [m, m, rad]."""


def reference_map(log: Log, reference: np.ndarray) -> OccupancyGrid:
    """Draw a log at reference poses, shape (m, 3) [m, rad], seen from the first one, which becomes the origin."""
    mapper = GivenPoseSlam(log.lidar, MAP)
    mapper.reset(np.random.default_rng(0))
    before = Pose2D(0.0, 0.0, 0.0)
    for ranges, row in zip(log.ranges, reference.tolist()):
        pose = Pose2D(*row)
        mapper.update(ranges, before.between(pose))
        before = pose
    grid = mapper.belief.grid
    data = np.where(grid.data >= SHARE_OF_HITS, OCCUPIED, np.minimum(grid.data, 0)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


def localise(log: Log, grid: OccupancyGrid, reference: np.ndarray, params: AmclParams, seed: int) -> dict[str, float]:
    """Track the robot along its raw odometry, from the reference's first pose on.

    Errors are those of the estimate at every scan against the reference pose at that scan, in the map's frame.
    """
    amcl = Amcl(log.lidar, params)
    amcl.reset(grid, Pose2D(0.0, 0.0, 0.0), np.random.default_rng(seed), covariance=np.diag(np.square(START_STD)))
    poses, seconds, counts, lost = [], [], [], []
    for ranges, motion in zip(log.ranges, log.motions()):
        begin = time.perf_counter()
        estimate = amcl.update(ranges, motion)
        if estimate.is_corrected:
            seconds.append(time.perf_counter() - begin)
            counts.append(amcl.num_particles)
        poses.append(estimate.pose)
        lost.append(estimate.is_lost)
    error = np.array(poses) - reference
    turned = (error[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    distance = np.hypot(error[:, 0], error[:, 1])
    return {
        "position_rmse_m": float(np.sqrt(np.mean(distance**2))),
        "position_median_m": float(np.median(distance)),
        "position_max_m": float(distance.max()),
        "heading_rmse_deg": math.degrees(float(np.sqrt(np.mean(turned**2)))),
        "update_us": 1e6 * float(np.median(seconds)),
        "particles": float(np.mean(counts)),
        "lost_share": float(np.mean(lost)),
    }


def measure(path: Path, seeds: range) -> dict[str, dict[str, float]]:
    """Compare filters on the log: medians over seeds, by filter.

    Args:
        path: the log's arrays, which also hold the reference, `corr`.
        seeds: of the filters' noise.
    """
    log = load_log(path)
    with np.load(path) as arrays:
        corrected = arrays["corr"][log.scan_rows]
    origin = Pose2D(*corrected[0])
    reference = np.array([origin.between(Pose2D(*row)) for row in corrected.tolist()])
    grid = reference_map(log, reference)
    results = {}
    for name, params in FILTERS.items():
        few = seeds[:1] if params.sensor == "beam" else seeds
        runs = [localise(log, grid, reference, params, seed) for seed in few]
        results[name] = {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
    return results
