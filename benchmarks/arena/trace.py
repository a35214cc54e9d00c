"""The course of an episode: the estimated path, and when which cell became known."""

import io
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.baselines.episode import Episode
from lidarnaut.benchmarks.arena.records import Row
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import open_archive
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.navigation.costmap import known_window

WHAT, HINT = "trace of an episode", "choose another --out, or remove the folder"


class Curve(NamedTuple):
    """The course of an episode, shape (n,), float64: one sample at the reset and one after every step."""

    time: np.ndarray
    """Since the reset [s]."""
    path_length: np.ndarray
    """True distance driven, by all robots [m]."""
    progress: np.ndarray
    """How much of the task is done, from 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The course of an episode. Trail and map are in the map frame, walls and the start in the world frame."""

    curve: Curve
    trail: np.ndarray
    """Shape (n, 2), float32, estimated positions of the (first) robot at the samples [m]."""
    grid: OccupancyGrid
    """The final map, cut to what is known."""
    known_since: np.ndarray
    """Shape of the map, float32, time at which a cell became known [s]; infinite where it did not."""
    start: Pose2D
    """Pose of the map frame."""
    segments: np.ndarray
    """Shape (k, 4), float32, true walls as (x0, y0, x1, y1) [m]."""
    circles: np.ndarray
    """Shape (m, 3), float32, true static cylinders as (x, y, radius) [m]."""

    @property
    def has_grown(self) -> bool:
        """Whether cells became known after the start: the map was made meanwhile."""
        known = self.known_since[np.isfinite(self.known_since)]
        return bool(known.size and known.max() > known.min())

    def to_bytes(self) -> bytes:
        """Return the trace as a compressed NumPy archive."""
        archive = io.BytesIO()
        np.savez_compressed(
            archive,
            curve=np.stack(self.curve).astype(np.float32),
            trail=self.trail,
            map=self.grid.data,
            resolution=self.grid.resolution,
            origin=self.grid.origin,
            known_since=self.known_since,
            start=self.start,
            segments=self.segments,
            circles=self.circles,
        )
        return archive.getvalue()

    @classmethod
    def load(cls, path: Path) -> "Trace":
        """Read a file with what `to_bytes` returned."""
        with open_archive(path, WHAT, HINT) as file:
            x, y = file["origin"]
            grid = OccupancyGrid(file["map"], float(file["resolution"]), (float(x), float(y)))
            curve = Curve(*file["curve"])
            start = Pose2D(*map(float, file["start"]))
            return cls(curve, file["trail"], grid, file["known_since"], start, file["segments"], file["circles"])


class Recorder:
    """Watches an episode; pass `watch` to `run_episode` and ask for the `trace` afterwards."""

    def __init__(self, env: LidarEnv) -> None:
        self._env = env
        self._trail: list[tuple[float, float]] = []
        self._known_since: np.ndarray = np.empty((0, 0), dtype=np.float32)
        self._origin = (0.0, 0.0)

    def watch(self, info: dict[str, Any]) -> None:
        """Record the pose estimate, and the time of the cells that became known."""
        belief = self._env.belief
        self._trail.append((belief.pose.x, belief.pose.y))
        self._fit(belief.grid)
        # The belief's new cells are those of the decision's last step, or of one robot; a known map has none.
        if len(self._trail) == 1 or "decision_steps" in info or len(self._env.robots) > 1:
            rows, cols = np.nonzero((belief.grid.data >= 0) & np.isinf(self._known_since))
        else:
            rows, cols = belief.update.new_cells.T
        self._known_since[rows, cols] = np.minimum(self._known_since[rows, cols], info["time"])

    def trace(self, episode: Episode) -> Trace:
        """Return the course of the episode that has ended."""
        env, course = self._env, episode.course
        curve = Curve(course.of("time"), course.of("path_length"), course.samples[env.task.progress])
        return Trace(
            curve,
            np.array(self._trail, dtype=np.float32),
            crop_to_known(env.belief.grid, margin=0),
            self._known_since[known_window(env.belief.grid.data).slices],
            env.map_pose,
            env.world.segments.astype(np.float32),
            env.world.circles.astype(np.float32),
        )

    def _fit(self, grid: OccupancyGrid) -> None:
        """Keep the times under their cells when the map has grown, or was redrawn with other borders."""
        if self._known_since.shape == grid.data.shape and self._origin == grid.origin:
            return
        grown: np.ndarray = np.full(grid.data.shape, np.inf, dtype=np.float32)
        col, row = (round((old - new) / grid.resolution) for old, new in zip(self._origin, grid.origin, strict=True))
        before = self._known_since[max(-row, 0) :, max(-col, 0) :]
        into = grown[max(row, 0) :, max(col, 0) :][: before.shape[0], : before.shape[1]]
        into[:] = before[: into.shape[0], : into.shape[1]]
        self._known_since, self._origin = grown, grid.origin


def trace_path(folder: Path, row: Row) -> Path:
    """Return where the trace of a row's episode lies."""
    return folder / "episodes" / f"{episode_name(row)}.npz"


def recording_path(folder: Path, row: Row) -> Path:
    """Return where the recording of a row's episode lies, for the player."""
    return folder / "recordings" / f"{episode_name(row)}.npz"


def episode_name(row: Row) -> str:
    """Return the name of the files of a row's episode, without a suffix."""
    names = ("policy", "world", "robot", "physics", "slam", *(["people"] if row["people"] != "0" else []), "seed")
    return "__".join(slug(str(row[name])) for name in names)


def load_curve(folder: Path, row: Row) -> Curve:
    """Read the curve of a row's episode, and nothing else of its trace."""
    with open_archive(trace_path(folder, row), WHAT, HINT) as file:
        return Curve(*file["curve"])


def slug(name: str) -> str:
    """Turn a policy's or a world's name, which may be a path, into a part of a file name; different names stay so."""
    simple = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_")
    return name if simple == name else f"{simple[-60:]}-{zlib.crc32(name.encode()):08x}"
