"""File format of recorded episodes: compressed NumPy archives."""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np

from lidarnaut.envs.files import open_archive

FORMAT = 3
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""Cell values of recorded maps."""
RANGE_STEPS = 254
"""Integer that stands for the lidar's maximum range in recorded scans."""
NO_RETURN = 255
BODY_KINDS = ("attentive", "blind", "standing", "fixed_route")
CANDIDATE_COLUMNS = ("x", "y", "cost", "visible", "failures", "score")
"""Columns of frontier candidates: position, map frame [m], path cost [m], visible unknown area [m2], failed attempts,
and score (NaN if unknown)."""
_ENDS = {"map_ends": "map_cells", "plan_ends": "plans", "track_ends": "tracks", "candidate_ends": "candidates"}

_FACTS = ("explorer", "world", "robot", "radius", "lidar", "progress", "start", "map", "floor", "figures")


def ends_of(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return end indices (exclusive) of n arrays in their concatenation, shape (n,)."""
    return np.cumsum([0, *map(len, parts)])[1:]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Recorded episode of one robot: n samples, m frontier decisions. Annotations give dtypes and shapes."""

    about: dict[str, Any]
    """Metadata as JSON: `explorer`, `world`, `robot`, `seed`, `end_reason`; `progress`, name of the progress measure;
    `radius` of the robot [m]; `lidar` with `range_max` [m], `mount` (x, y, yaw), `angles` [rad] and `is_full_turn`;
    `start`, world pose of the map frame; `map` with `shape` (rows, columns), `resolution` [m] and `origin` (map
    frame [m]); `floor` with `resolution` and `origin` (world frame); `figures`, final metrics as text; optional
    `bodies`, kind of each entry of `people_radii`, from `BODY_KINDS` or "robot"."""
    time: Annotated[np.ndarray, np.float32, "n"]
    """Time since the reset [s]."""
    true_poses: Annotated[np.ndarray, np.float32, "n", 3]
    """True poses x, y, heading, world frame [m, m, rad]."""
    poses: Annotated[np.ndarray, np.float32, "n", 3]
    """Estimated poses x, y, heading, map frame [m, m, rad]."""
    goals: Annotated[np.ndarray, np.float32, "n", 2]
    """Goal positions, map frame [m]; NaN without goal."""
    progress: Annotated[np.ndarray, np.float32, "n"]
    """Share of the task completed, from 0 to 1."""
    path_length: Annotated[np.ndarray, np.float32, "n"]
    """True distance driven [m]."""
    contacts: Annotated[np.ndarray, np.int32, "n"]
    """Number of collisions since the reset."""
    scans: Annotated[np.ndarray, np.uint8, "n", "beams"]
    """Ranges of evenly spaced beams as integers: 1 to 254 in units of `range_max / 254`, 255 no return, 0 lost beam."""
    map_cells: Annotated[np.ndarray, np.int32, "changes"]
    """Row-major indices of map cells that changed since the previous sample, concatenated over samples."""
    map_changes: Annotated[np.ndarray, np.uint8, "changes"]
    """Changes of the cells in `map_cells`: bitwise XOR of old and new value (0 unknown, 1 free, 2 occupied)."""
    map_ends: Annotated[np.ndarray, np.int32, "n"]
    """End index (exclusive) of each sample's changes in `map_cells`."""
    plans: Annotated[np.ndarray, np.float32, "corners", 2]
    """Corners (x, y) of the planned paths of all samples, concatenated, map frame [m]."""
    plan_ends: Annotated[np.ndarray, np.int32, "n"]
    """End index (exclusive) of each sample's path in `plans`."""
    decision_times: Annotated[np.ndarray, np.float32, "m"]
    """Time of each frontier decision [s]."""
    decision_chosen: Annotated[np.ndarray, np.int32, "m"]
    """Index of the chosen candidate frontier per decision; -1 if none was chosen."""
    candidates: Annotated[np.ndarray, np.float32, "candidates", len(CANDIDATE_COLUMNS)]
    """Frontier candidates of all decisions, concatenated; columns as in `CANDIDATE_COLUMNS`."""
    candidate_ends: Annotated[np.ndarray, np.int32, "m"]
    """End index (exclusive) of each decision's frontiers in `candidates`."""
    segments: Annotated[np.ndarray, np.float32, "segments", 4]
    """True walls as (x0, y0, x1, y1), world frame [m]."""
    circles: Annotated[np.ndarray, np.float32, "circles", 3]
    """True static cylinders as (x, y, radius), world frame [m]."""
    route: Annotated[np.ndarray, np.float32, "points", 2]
    """Points of the route to follow, map frame [m]; may be empty."""
    people_radii: Annotated[np.ndarray, np.float32, "people"]
    """Radii of people, then of other robots [m]."""
    people: Annotated[np.ndarray, np.float32, "n", "coordinates"]
    """True (x, y, vx, vy) of each person, then of each other robot, in one row per sample, world frame [m, m/s]."""
    tracks: Annotated[np.ndarray, np.float32, "tracks", 5]
    """Tracked people of all samples: x, y, vx, vy, radius, map frame [m, m/s]."""
    track_ends: Annotated[np.ndarray, np.int32, "n"]
    """End index (exclusive) of each sample's people in `tracks`."""
    floor: Annotated[np.ndarray, np.uint8, "rows", "columns"]
    """Grid of the floor to explore, world frame: 1 for cells to explore, else 0; a single 0 for other tasks."""
    markers: Annotated[np.ndarray, np.float32, "markers", 6]
    """Markers of the policy that appear or vanish: index of the sample, kind (0 candidate goal, 1 chosen goal, 2 found
    point, 3 edge of the global tree, 4 edge of a local tree, 5 cell predicted to be floor, 6 part of the tour),
    position (x, y), end of an edge (x, y) or probability and side of a cell, map frame [m]."""

    @classmethod
    def of(cls, about: dict[str, Any], **arrays: Any) -> "Recording":
        """Create a recording from metadata and arrays (fields by name), converted to the annotated dtypes."""
        numbers = {name: np.asarray(array).astype(_LAYOUT[name][0]) for name, array in arrays.items()}
        for name in numbers:
            if isinstance(width := _LAYOUT[name][-1], int):
                numbers[name] = numbers[name].reshape(-1, width)
        return cls(about, **numbers)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, name) for name in _LAYOUT}

    def to_bytes(self) -> bytes:
        """Return the content of the recording's file. Equal episodes give equal bytes."""
        archive = io.BytesIO()
        about = json.dumps(self.about | {"format": FORMAT}, allow_nan=False)
        np.savez_compressed(archive, about=np.frombuffer(about.encode(), dtype=np.uint8), **self.arrays)  # type: ignore[arg-type]
        return archive.getvalue()

    @classmethod
    def load(cls, path: str | Path) -> "Recording":
        """Read a recording from a file; OSError if it is not readable, ValueError if it is no valid recording."""
        with open_archive(path, "recorded episode", "record one with `python evaluate.py ... --record`") as archive:
            if missing := sorted({"about", *_LAYOUT} - {*archive.files}):
                raise ValueError(f"it lacks {', '.join(missing[:3])}{', ...' * (len(missing) > 3)}")
            about = json.loads(archive["about"].tobytes())
            recording = cls(about, **{name: archive[name] for name in _LAYOUT})
            recording._check()
        return recording

    def _check(self) -> None:
        if self.about["format"] != FORMAT:
            raise ValueError(f"it has format {self.about['format']}, this version reads {FORMAT}")
        if missing := sorted(set(_FACTS) - self.about.keys()):
            raise ValueError(f"about lacks {', '.join(missing)}")
        sizes: dict[str | int, int] = {}
        for name, (kind, *shape) in _LAYOUT.items():
            array = getattr(self, name)
            if array.dtype != kind or array.ndim != len(shape):
                raise ValueError(f"{name} is {array.dtype} in {array.ndim} dimensions")
            counts = [k if isinstance(k, int) else sizes.setdefault(k, n) for k, n in zip(shape, array.shape)]
            if list(array.shape) != counts:
                raise ValueError(f"{name} has shape {array.shape}, not {tuple(counts)}")
        if not len(self.time):
            raise ValueError("it has no samples")
        for name, counted in _ENDS.items():
            ends = np.concatenate([[0], getattr(self, name)])
            if (np.diff(ends) < 0).any() or ends[-1] != len(getattr(self, counted)):
                raise ValueError(f"{name} do not match {counted}")
        if not (np.diff(self.markers[:, 0], prepend=0.0) >= 0.0).all():
            raise ValueError("markers are not sorted by sample")
        rows, columns = self.about["map"]["shape"]
        if len(self.map_cells) and not 0 <= self.map_cells.min() <= self.map_cells.max() < rows * columns:
            raise ValueError("map_cells lie outside of the map")


_LAYOUT: dict[str, tuple[Any, ...]] = {
    name: hint.__metadata__ for name, hint in get_type_hints(Recording, include_extras=True).items() if name != "about"
}
