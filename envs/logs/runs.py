"""Running and evaluating a SLAM on a log."""

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.estimation.belief import check_belief
from lidarnaut.envs.files import with_defaults, write_file
from lidarnaut.envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.lines import next_cell, start_walk
from lidarnaut.envs.geometry.occupancy_grid import crop_to_known
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import HectorParams
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.worlds import save_map

from .log import Log
from .relations import RelationError, relation_error
from .trajectory import follow_odometry, odometry_scales, save_trajectory, scale_std

END_MARGIN = 0.3
"""Occupied cells within this distance of a beam's end are no conflict [m], for thick walls and grazing beams."""
MAX_CONFLICTS = 0.2
"""Maximum share of beams through occupied cells in a consistent map. Intel Research Lab: 0.06 to 0.16 if SLAM succeeds,
else 0.24 to 0.53."""
CHUNK = 256


class Replayed(NamedTuple):
    """Poses and computation times of a SLAM on a log with m scans."""

    online: np.ndarray
    """Pose x, y, heading estimated after each scan, shape (m, 3), float64 [m, m, rad]."""
    final: np.ndarray
    """Poses at the scans after all corrections, shape (m, 3), float64 [m, m, rad]."""
    seconds: np.ndarray
    """Computation time per scan, shape (m,), float64 [s]."""
    is_lost: np.ndarray
    """Whether the SLAM was lost after each scan, shape (m,), bool."""


@dataclass(frozen=True, slots=True)
class Run:
    """Errors and computation times of a SLAM on a log."""

    slam: str
    seed: int
    milliseconds: float
    """Mean computation time per scan [ms]."""
    milliseconds_p99: float
    """99th percentile of the computation time per scan [ms]."""
    milliseconds_max: float
    """Maximum computation time per scan [ms]."""
    lost_share: float
    """Share of scans after which the SLAM was lost, from 0 to 1."""
    conflict_share: float
    """Share of beams that pass through cells occupied in other scans (inconsistent map), from 0 to 1."""
    odometry_scales: tuple[float, float] = (math.nan, math.nan)
    """Factors of distances and turns that fit odometry to the estimated poses best."""
    scale_std: float = math.nan
    """Standard error of the factor of distances, from its changes along the path; NaN for paths below 38 m."""
    path_length: float = math.nan
    """Length of the path by odometry [m]."""
    loop_closures: int | None = None
    errors: dict[str, RelationError] = field(default_factory=dict)
    """Errors relative to reference poses, by trajectory (`online`, `final`) and set of references, such as `final
    unambiguous`."""


def replay(log: Log, slam: Estimator, seed: int, progress: bool = False) -> Replayed:
    """Run a SLAM on a log; return poses and computation times.

    Final poses come from `Belief.path` (one pose per scan), set at map corrections or by `finish`. With `slam.anchor`,
    the path holds only some poses.

    Raises:
        ValueError: invalid belief or corrected path.
    """
    with_defaults(slam, Estimator).reset(np.random.default_rng(seed))
    anchors: list[Any] = []
    online, seconds = np.empty((len(log.ranges), 3)), np.empty(len(log.ranges))
    is_lost = np.zeros(len(log.ranges), dtype=np.bool_)
    corrected = online[:0]
    steps = Progress(zip(log.ranges, log.motions()), f"seed {seed}", len(online), leave=False, disable=not progress)
    for k, (ranges, motion) in enumerate(steps):
        begin = time.perf_counter()
        belief = slam.update(Reading.of_scan(ranges), motion)
        seconds[k] = time.perf_counter() - begin
        check_belief(belief, type(slam).__name__)
        online[k], is_lost[k] = belief.pose, belief.is_lost
        anchors.append(slam.anchor)
        if belief.update.redrawn and belief.path is not None:
            corrected = _final_poses(belief.path, anchors, k + 1)
    slam.finish()
    # Without a `finish` of its own, the path may end at an earlier correction.
    if slam.belief.path is not None and type(slam).finish is not Estimator.finish:
        corrected = _final_poses(slam.belief.path, anchors, len(online))
    return Replayed(online, np.concatenate([corrected, online[len(corrected) :]]), seconds, is_lost)


def measure(
    log: Log, slam: Estimator, name: str, seed: int, replayed: Replayed, relations: dict[str, np.ndarray]
) -> Run:
    """Return errors and computation times of a SLAM run; `relations`: named sets of reference relative poses.

    ValueError if a set has no relative pose within the log.
    """
    milliseconds = 1e3 * replayed.seconds
    errors: dict[str, RelationError] = {}
    for when, poses in (("online", replayed.online), ("final", replayed.final)):
        trajectory = follow_odometry(log.odometry, log.scan_rows, poses)
        for label, some in relations.items():
            errors[f"{when} {label}"] = relation_error(log.times, trajectory, some)
    times = float(milliseconds.mean()), float(np.percentile(milliseconds, 99)), float(milliseconds.max())
    shares = float(replayed.is_lost.mean()), conflict_share(log, replayed.final)
    odometry = log.odometry[log.scan_rows]
    scales = odometry_scales(odometry, replayed.final), scale_std(odometry, replayed.final)
    path_length = float(np.hypot(*np.diff(odometry[:, :2], axis=0).T).sum())
    return Run(name, seed, *times, *shares, *scales, path_length, slam.loop_closures, errors)


def conflict_share(log: Log, poses: np.ndarray) -> float:
    """Return the share of beams that pass through cells occupied in other scans, from 0 to 1.

    All scans are integrated into a new map. The share rises if rooms overlap, but not if the trajectory is bent without
    overlap. `poses`: base poses at the scans, shape (m, 3), float64 [m, m, rad]. NaN if no beam has a return or a pose
    is not finite.
    """
    if not np.isfinite(poses).all():
        return math.nan
    map = LogOddsMap(HectorParams(num_levels=1, skip_exceeding=True), log.lidar)
    try:
        for first in range(0, len(poses), CHUNK):
            map.integrate_all(log.ranges[first : first + CHUNK], poses[first : first + CHUNK])
    except MemoryError:
        return math.nan
    mount, grid = log.lidar.mount, map.grid
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + c * mount.x - s * mount.y - grid.origin[0]
    y = poses[:, 1] + s * mount.x + c * mount.y - grid.origin[1]
    sensors = np.stack([x / grid.resolution, y / grid.resolution, poses[:, 2] + mount.yaw], axis=1)
    over = (log.ranges, log.lidar.angles, sensors, grid.resolution)
    conflicts, count = _count_conflicts(grid.data, *over, log.lidar.range_max)
    return conflicts / count if count else math.nan


@njit(cache=True, error_model="numpy")
def _count_conflicts(occupancy, ranges, angles, sensors, resolution, range_max):
    height, width = occupancy.shape
    conflicts = count = 0
    for i in range(ranges.shape[0]):
        x, y, theta = sensors[i, 0], sensors[i, 1], sensors[i, 2]
        for k in range(ranges.shape[1]):
            if not ranges[i, k] <= range_max:
                continue
            count += 1
            length = (ranges[i, k] - END_MARGIN) / resolution
            if length <= 0.0:
                continue
            angle = theta + angles[k]
            walk = start_walk(x, y, x + length * math.cos(angle), y + length * math.sin(angle))
            while walk.rows_left + walk.cols_left > 0:
                walk = next_cell(walk)
                is_inside = 0 <= walk.row < height and 0 <= walk.col < width
                if is_inside and occupancy[walk.row, walk.col] >= 50:
                    conflicts += 1
                    break
    return conflicts, count


def save_replay(folder: Path, log: Log, slam: Estimator, seed: int, replayed: Replayed) -> None:
    """Write the results of a SLAM run: map, picture, trajectories, and pose graph, if any.

    Files: `map_SEED.pgm` and `.yaml`, `map_with_path_SEED.png`, `trajectory_SEED.tum` (final poses),
    `trajectory_online_SEED.tum` if different, `pose_graph_SEED.g2o`.
    """
    grid = slam.belief.grid
    picture(grid, replayed.final[:, :2]).save(folder / f"map_with_path_{seed}.png", optimize=True)
    save_map(grid, folder / f"map_{seed}.pgm")
    final = follow_odometry(log.odometry, log.scan_rows, replayed.final)
    save_trajectory(folder / f"trajectory_{seed}.tum", log.times, final)
    if not np.array_equal(replayed.online, replayed.final):
        online = follow_odometry(log.odometry, log.scan_rows, replayed.online)
        save_trajectory(folder / f"trajectory_online_{seed}.tum", log.times, online)
    if (graph := slam.pose_graph) is not None:
        save_g2o(folder / f"pose_graph_{seed}.g2o", graph.nodes, graph.edges)


def save_g2o(path: Path, nodes: np.ndarray, edges: Iterable[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
    """Write a 2D pose graph as g2o text with a fixed first node (Kümmerle et al., ICRA 2011).

    `nodes`: poses, shape (n, 3), map frame [m, m, rad]. `edges`: two node indices, relative pose, shape (3,) [m, m,
    rad], and information matrix, shape (3, 3).

    Raises:
        ValueError: missing node, or a number that is not finite.
    """

    def join(values: np.ndarray) -> str:
        if not np.isfinite(values).all():
            raise ValueError(f"values of a pose graph must be finite, got {np.asarray(values).tolist()}")
        return " ".join(repr(float(value)) for value in values)

    lines = [f"VERTEX_SE2 {k} {join(node)}" for k, node in enumerate(np.reshape(nodes, (-1, 3)))]
    num_nodes = len(lines)
    for first, second, motion, information in edges:
        if not (0 <= first < num_nodes and 0 <= second < num_nodes):
            raise ValueError(f"edge from {first} to {second} in a graph of {num_nodes} nodes")
        upper = np.asarray(information)[np.triu_indices(3)]
        lines.append(f"EDGE_SE2 {first} {second} {join(motion)} {join(upper)}")
    lines += ["FIX 0"] * bool(num_nodes)  # last: GTSAM stops reading edges at a line of another kind
    write_file(path, "".join(f"{line}\n" for line in lines))


def picture(grid: OccupancyGrid, positions: np.ndarray) -> Image.Image:
    """Draw the known part of a map with a margin of 10 cells: white free, black occupied, grey unknown.

    `positions`: path in blue, shape (n, 2), map frame [m].
    """
    known = crop_to_known(grid, margin=10)
    cells = known.data.astype(float)
    grey = np.where(cells == UNKNOWN, 190.0, 255.0 - 2.55 * cells).round().astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(grey[::-1])).convert("RGB")
    points = (positions - known.origin) / grid.resolution
    points[:, 1] = len(cells) - points[:, 1]
    ImageDraw.Draw(image).line([tuple(point) for point in points.tolist()], fill=(40, 90, 220))
    return image


def _final_poses(path: np.ndarray, anchors: list[Any], num_scans: int) -> np.ndarray:
    if None not in anchors:
        poses = [Pose2D(*path[node].tolist()).compose(relative) for node, relative in anchors]
        return np.array(poses, dtype=np.float64)
    if path.shape != (num_scans, 3):
        found = f"a corrected path of shape {path.shape} after {num_scans} scans"
        raise ValueError(f"the SLAM returned {found}; Belief.path must hold one pose per scan")
    return path.copy()
