"""Recorded data of episodes for plots: progress, estimated path, and growth of the map."""

import io
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.baselines.episode import Episode
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import open_archive
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.occupancy_grid import crop_to_known, known_window

WHAT, HINT = "trace of an episode", "choose another --out, or remove the folder"
NO_GOAL = np.full(2, np.nan, dtype=np.float32)


class ProgressCurve(NamedTuple):
    """Task progress over time and distance, at the reset and after every step.

    Arrays have shape (n,), float64 when recorded, float32 when loaded.
    """

    time: np.ndarray
    """Time since the reset [s]."""
    path_length: np.ndarray
    """True distance driven, summed over robots [m]."""
    progress: np.ndarray
    """Share of the task completed, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Progress, path and map of an episode. Path and map are in the map frame, true obstacles in the world frame."""

    curve: ProgressCurve
    trail: np.ndarray
    """Estimated positions (x, y) of the first robot in the map frame, shape (n, 2), float32 [m]."""
    grid: OccupancyGrid
    """Final map, cropped to known cells."""
    known_since: np.ndarray
    """Time when each map cell was first observed, shape (rows, columns), float32 [s]; inf if unobserved."""
    start: Pose2D
    """Pose of the map frame in the world frame."""
    segments: np.ndarray
    """True walls (x0, y0, x1, y1) in the world frame, shape (k, 4), float32 [m]."""
    circles: np.ndarray
    """True cylinders (x, y, radius) in the world frame, shape (m, 3), float32 [m]."""
    people: np.ndarray
    """True people (x, y, radius) at the end, in the world frame, shape (k, 3), float32 [m]."""
    goal: np.ndarray
    """Last goal (x, y) in the map frame, shape (2,), float32 [m]; NaN without a goal."""

    @property
    def is_given(self) -> bool:
        """Whether the map was known from the beginning."""
        return bool((self.known_since[self.grid.data >= 0] <= self.curve.time[0]).all())

    def to_bytes(self) -> bytes:
        archive = io.BytesIO()
        curve = np.stack(self.curve).astype(np.float32)
        grid: dict[str, Any] = {"map": self.grid.data, "resolution": self.grid.resolution, "origin": self.grid.origin}
        names = ("known_since", "start", "segments", "circles", "people", "goal")
        others = {name: getattr(self, name) for name in names}
        np.savez_compressed(archive, curve=curve, trail=self.trail, **grid, **others)
        return archive.getvalue()

    @classmethod
    def load(cls, path: str | Path) -> "Trace":
        with open_archive(path, WHAT, HINT) as file:
            x, y = file["origin"]
            grid = OccupancyGrid(file["map"], float(file["resolution"]), (float(x), float(y)))
            curve = ProgressCurve(*file["curve"])
            start = Pose2D(*map(float, file["start"]))
            goal = file.get("goal", NO_GOAL)  # none in traces of earlier versions
            shapes = file["segments"], file["circles"], file["people"], goal
            return cls(curve, file["trail"], grid, file["known_since"], start, *shapes)


class Recorder:
    """Records progress, path and map growth of an episode; `watch` is called after every step."""

    def __init__(self, env: LidarEnv) -> None:
        self._env = env
        self._trail: list[tuple[float, float]] = []
        self._known_since: np.ndarray = np.empty((0, 0), dtype=np.float32)
        self._origin = (0.0, 0.0)

    def watch(self, info: dict[str, Any]) -> None:
        belief = self._env.belief
        self._trail.append((belief.pose.x, belief.pose.y))
        self._fit(belief.grid)
        # `new_cells` covers only one robot, and only the last step of a decision.
        if len(self._trail) == 1 or "decision_steps" in info or len(self._env.robots) > 1:
            rows, cols = np.nonzero((belief.grid.data >= 0) & np.isinf(self._known_since))
        else:
            rows, cols = belief.update.new_cells.T
        self._known_since[rows, cols] = np.minimum(self._known_since[rows, cols], info["time"])

    def trace(self, episode: Episode) -> Trace:
        env, history = self._env, episode.history
        curve = ProgressCurve(history.of("time"), history.of("path_length"), history.samples[env.task.progress])
        return Trace(
            curve,
            np.array(self._trail, dtype=np.float32),
            crop_to_known(env.belief.grid, margin=0),
            self._known_since[known_window(env.belief.grid.data).slices],
            env.map_pose,
            env.world.segments.astype(np.float32),
            env.world.circles.astype(np.float32),
            env.simulator.people[:, [0, 1, 4]].astype(np.float32),
            NO_GOAL if env.task.goal is None else np.array(env.task.goal[:2], dtype=np.float32),
        )

    def _fit(self, grid: OccupancyGrid) -> None:
        if self._known_since.shape == grid.data.shape and self._origin == grid.origin:
            return
        grown: np.ndarray = np.full(grid.data.shape, np.inf, dtype=np.float32)
        col, row = (round((old - new) / grid.resolution) for old, new in zip(self._origin, grid.origin, strict=True))
        before = self._known_since[max(-row, 0) :, max(-col, 0) :]
        into = grown[max(row, 0) :, max(col, 0) :][: before.shape[0], : before.shape[1]]
        into[:] = before[: into.shape[0], : into.shape[1]]
        self._known_since, self._origin = grown, grid.origin


def trace_path(folder: Path, row: Row) -> Path:
    return folder / "episodes" / f"{episode_name(row)}.npz"


def recording_path(folder: Path, row: Row) -> Path:
    return folder / "recordings" / f"{episode_name(row)}.npz"


def episode_name(row: Row) -> str:
    names = ("policy", "world", "robot", "physics", "slam", *(["people"] if row["people"] != "0" else []), "seed")
    return "__".join(slug(str(row[name])) for name in names)


def load_curve(folder: Path, row: Row) -> ProgressCurve:
    with open_archive(trace_path(folder, row), WHAT, HINT) as file:
        return ProgressCurve(*file["curve"])


def slug(name: str) -> str:
    """Convert a name or path to a unique file name."""
    simple = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_")
    return name if simple == name else f"{simple[-60:]}-{zlib.crc32(name.encode()):08x}"
