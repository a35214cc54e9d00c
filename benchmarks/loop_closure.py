"""Time of the parts of a loop closure: `python -m benchmarks.loop_closure`.

A robot drives through a world; a submap holds the scans of its first metres, at true poses. A scan from there is
searched in it around a pose that is wrong by half the window, and around one that is turned by a right angle, where the
true pose is not found. Times are the least of all repetitions and the median, on one core.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro

from benchmarks.recorded_drives import make_setup, record
from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.slam.graph.loop_closure import LoopClosureParams, hit_shares
from envs.slam.matching.branch_and_bound import SearchLimits, SearchWindow, angle_step, search
from envs.slam.matching.pyramid import build_pyramid
from envs.slam.matching.score_surface import SurfaceParams, match_covariance
from envs.slam.matching.submap_field import UNKNOWN_PERCENT, Scans, SensorModel, render_field
from envs.slam.scans import ScanGeometry, project_hits
from envs.worlds import load_world

WINDOWS = ((0.5, 0.1), (1.0, 0.225), (2.0, 0.475), (4.0, 0.6))
"""Half widths [m] and half angles [rad] of search windows."""


@dataclass(frozen=True)
class Options:
    """Time the parts of a loop closure."""

    world: str = "rmf_office_L1"
    """Library world, or path of a world file."""
    robot: str = "turtlebot3_waffle_pi"
    """Library robot, or path of a robot file."""
    nodes: int = 40
    """Number of scans in the submap, 0.2 m apart."""
    resolution: float = 0.05
    """Side of a cell [m]."""
    repetitions: int = 30
    """Number of times that everything is measured."""


def make_scans(options: Options) -> Scans:
    """Return the scans of a submap at true poses, in the frame of the first one."""
    setup = make_setup(load_world(options.world), load_robot(options.robot), "kinematic")
    rng = np.random.default_rng(0)
    drive = record(setup, setup.world.spawns[0], *rng.spawn(2), 120.0)
    truth = drive.truth[-len(drive.ranges) :]
    travelled = np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0, prepend=truth[:1, :2]).T))
    rows = np.searchsorted(travelled, 0.2 * np.arange(options.nodes))
    start, poses = Pose2D(*truth[0].tolist()), [Pose2D(*truth[k].tolist()) for k in rows]
    geometry, room = ScanGeometry.of(setup.robot.lidar, 1.0), np.empty((2, drive.ranges.shape[1]), dtype=np.float32)
    points = [room[:, : project_hits(drive.ranges[k], geometry, room)].T.copy() for k in rows]
    ends = np.cumsum([len(each) for each in points])
    spans = np.stack([ends - [len(each) for each in points], ends], axis=1)
    relative = np.array([start.between(pose) for pose in poses])
    return Scans(np.concatenate(points), spans, relative, geometry.mount_x, geometry.mount_y)


def measure(name: str, call: Callable[[], Any], repetitions: int) -> Any:
    """Time a call, print it, and return what it returns."""
    result, times = call(), []
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    print(f"{name:42s} {min(times):7.3f} ms, median {np.median(times):7.3f} ms", end="")
    return result


def main(options: Options) -> None:
    scans, resolution, count = make_scans(options), options.resolution, options.repetitions
    print(f"{options.nodes} scans of {options.robot} in {options.world}, {len(scans.points)} hits")
    field, geometry = measure("render the field", lambda: render_field(scans, resolution, SensorModel()), count)
    print(f"; {field.shape[1]} x {field.shape[0]} cells")
    build = (field, geometry, 5, WINDOWS[-1][0], UNKNOWN_PERCENT)
    pyramid = measure("build the pyramid", lambda: build_pyramid(*build), count)
    print()
    middle = options.nodes // 2
    points, truth = scans.points[slice(*scans.spans[middle])], Pose2D(*scans.poses[middle].tolist())
    limits = SearchLimits(0.8 * LoopClosureParams().min_score, 200_000)
    for half_width, half_angle in WINDOWS:
        window = SearchWindow(half_width, half_angle, angle_step(points, resolution))
        near = Pose2D(truth.x + 0.5 * half_width, truth.y - 0.5 * half_width, truth.theta + 0.5 * half_angle)
        for what, pose in (("near", near), ("turned", near._replace(theta=near.theta + 0.5 * math.pi))):
            name = f"search +-{half_width} m, +-{half_angle} rad, {what}"
            found = measure(name, lambda: search(pyramid, points, pose, window, limits), count)  # noqa: B023
            error = f"{np.hypot(found.x - truth.x, found.y - truth.y):.3f} m off" if found.found else "nothing"
            print(f"; {found.evaluations} evaluations, {error}")
    shares = measure("hits on occupied and free cells", lambda: hit_shares(field, geometry, points, truth), count)
    print(f"; {shares.occupied:.2f} occupied, {shares.free:.2f} free")
    surface = (pyramid, points, truth, SurfaceParams())
    covariance = measure("covariance from the score surface", lambda: match_covariance(*surface), count)
    print("; sigmas {:.3f} m, {:.3f} m, {:.4f} rad".format(*np.sqrt(np.diag(covariance))))


if __name__ == "__main__":
    main(tyro.cli(Options))
