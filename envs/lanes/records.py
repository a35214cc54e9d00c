"""What many lanes consist of: rows of shared arrays, and addresses of what belongs to one lane alone."""

from typing import NamedTuple

import numpy as np

from envs.robots import DriveRecord, LidarRecord
from envs.simulation.sensors import OTHER_NORMALS
from envs.simulation.state import STATE_SIZE


class Lanes(NamedTuple):
    """The numbers of all lanes, one row per lane. Addresses are those of the arrays that belong to the lane alone."""

    state: np.ndarray
    """Shape (n, 9), float64: of the kinematic simulator."""
    belief: np.ndarray
    """Shape (n, 3), float64: believed pose, map frame."""
    drawn: np.ndarray
    """Shape (n, 3), float64: pose at which the last scan was drawn, map frame."""
    start: np.ndarray
    """Shape (n, 3), float64: pose of the map frame in the world frame."""
    ticks: np.ndarray
    """Shape (n, 2), int64: encoder counts."""
    twist: np.ndarray
    """Shape (n, 2), float64: velocity by odometry [m/s, rad/s]."""
    ranges: np.ndarray
    """Shape (n, num_beams), float32: the scan [m]."""
    bumper: np.ndarray
    """Shape (n,), bool: contact during the last step."""
    collisions: np.ndarray
    """Shape (n,), int64: contacts so far."""
    path_length: np.ndarray
    """Shape (n,), float64: true distance driven [m]."""
    pose_error: np.ndarray
    """Shape (n, 2), float64: of position and heading [m, rad]."""
    gained: np.ndarray
    """Shape (n,), int64: explorable cells that became truly known in the last step."""
    quality: np.ndarray
    """Shape (n,), float64: weight with which the last scan is drawn; negative where it is not to be drawn."""
    touched: np.ndarray
    """Shape (n, 4), int64: first column and row and last column and row of the map that the last scan touches."""
    steps: np.ndarray
    """Shape (n,), int64: since the reset."""
    time_limit: np.ndarray
    """Shape (n,), float64 [s]."""
    segments: np.ndarray
    """Shape (n, 2), int64: address of the world's segments, and their number."""
    circles: np.ndarray
    """Shape (n, 3), int64: addresses of the circles before and after the step, and their number."""
    map: np.ndarray
    """Shape (n, 4), int64: addresses of the map's words and of its occupancy, its height and width."""
    pyramid: np.ndarray
    """Shape (n, 4), int64: addresses of the near and of the far level of the map's pyramid, each followed by its
    length."""
    corner: np.ndarray
    """Shape (n, 2), int64: column and row of the map's corner, counted from the map frame's origin."""
    area: np.ndarray
    """Shape (n, 4), int64: addresses of the explorable and of the seen cells, height and width of the raster."""
    area_frame: np.ndarray
    """Shape (n, 3), float64: origin (x, y) of that raster in the world frame and side of its cells [m]."""
    trail: np.ndarray
    """Shape (n, 3), int64: address of the trail's positions, their number, and how many there is room for."""
    normals: np.ndarray
    """Shape (n, k), float64: standard normal draws for the robot, as `Sensors.draw` makes them."""
    uniforms: np.ndarray
    """Shape (n, num_beams or 0), float64: uniform draws for lost beams."""
    candidates: np.ndarray
    """Shape (n, max_tries or 0, 3), float64: standard normal draws for the matcher."""

    @classmethod
    def of(cls, num_lanes: int, num_beams: int, loses_beams: bool, max_tries: int) -> "Lanes":
        """Make rows for `num_lanes` lanes."""
        integers = {"ticks": 2, "touched": 4, "segments": 2, "circles": 3, "map": 4, "pyramid": 4}
        integers |= {"corner": 2, "area": 4, "trail": 3}
        shapes = {
            "state": (STATE_SIZE,),
            "belief": (3,),
            "drawn": (3,),
            "start": (3,),
            "twist": (2,),
            "path_length": (),
            "pose_error": (2,),
            "quality": (),
            "time_limit": (),
            "area_frame": (3,),
            "normals": (OTHER_NORMALS + num_beams,),
            "uniforms": (num_beams if loses_beams else 0,),
            "candidates": (max_tries, 3),
        }
        rows = {name: np.zeros((num_lanes, *shape)) for name, shape in shapes.items()}
        rows |= {name: np.zeros((num_lanes, size), dtype=np.int64) for name, size in integers.items()}
        rows |= {name: np.zeros(num_lanes, dtype=np.int64) for name in ("collisions", "gained", "steps")}
        rows["ranges"] = np.zeros((num_lanes, num_beams), dtype=np.float32)
        rows["bumper"] = np.zeros(num_lanes, dtype=np.bool_)
        return cls(**rows)


class Numbers(NamedTuple):
    """What all lanes share: the params of robot and SLAM, as scalars that Numba takes; units as there."""

    drive: DriveRecord
    lidar: LidarRecord
    period: float
    substeps: int
    ticks_per_radian: float
    metres_per_tick: float
    odometry_track: float
    told_pose: bool
    told_truth: bool
    resolution: float
    block: int
    """Side of a near block of the map's pyramid [cells]."""
    sigma_xy: float
    """[cells]"""
    sigma_theta: float
    max_failed: int
    max_tries: int
    unvisited: int
    cell: int
    by_area: bool
    occupied_prob: float
    empty_prob: float
    quality: float
    raw_quality: float
    hole: float
    """[cells]"""
    add_blur: bool
    skip_exceeding: bool
    draw_distance: float
    draw_angle: float


class Scratch(NamedTuple):
    """Room to work in, one row per thread."""

    points: np.ndarray
    """Shape (threads, 2, num_beams), float32."""
    ends: np.ndarray
    """Shape (threads, num_beams, 2), float64."""
    new_cells: np.ndarray
    """Shape (threads, most cells of a scan, 2), int32."""

    @classmethod
    def of(cls, num_threads: int, num_beams: int, reach: int) -> "Scratch":
        """Make room for scans of `num_beams` beams that cross at most `reach` cells each."""
        return cls(
            np.empty((num_threads, 2, num_beams), dtype=np.float32),
            np.empty((num_threads, num_beams, 2)),
            np.empty((num_threads, num_beams * reach, 2), dtype=np.int32),
        )


class Views(NamedTuple):
    """Observations of all lanes; see `ExploreEnv`."""

    scan: np.ndarray
    map_near: np.ndarray
    map_far: np.ndarray
    motion: np.ndarray
