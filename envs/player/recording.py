"""The file of a recorded episode: a compressed NumPy archive."""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np

from lidarnaut.envs.files import open_archive

FORMAT = 3
"""Number of this layout."""
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""Kinds of map cells."""
RANGE_STEPS = 254
"""Ranges count in this share of the lidar's greatest range; one step more is no return."""
NO_RETURN, NO_MEASUREMENT = 255, 0
"""Values of a scan where nothing was within range, and where the beam was lost."""
CANDIDATE_COLUMNS = ("x", "y", "cost", "visible", "failures", "score")
"""Of a candidate: its frontier in the map frame [m], cost of the path [m], unknown area in view [m2], attempts that
failed, and the score by which the explorer chose, NaN where it has none."""
_ENDS = {"map_ends": "map_cells", "plan_ends": "plans", "track_ends": "tracks", "candidate_ends": "candidates"}
"""Ends of what belongs to each sample, or decision, and the array that they count in."""

_FACTS = ("explorer", "world", "robot", "radius", "lidar", "progress", "start", "map", "floor", "figures")
"""Least of the keys of `about`."""


def ends_of(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return where each part ends when all are joined, shape (n,)."""
    return np.cumsum([0, *map(len, parts)])[1:]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The course of an episode, n samples of one robot and m decisions.

    Arrays are annotated by type and shape, in which a name stands for the same number everywhere.
    """

    about: dict[str, Any]
    """What is said once, as JSON: `explorer`, `world`, `robot`, `seed`, `end_reason`; what `progress` is called;
    `radius` [m]; `lidar` with
    `range_max` [m], `mount` (x, y, yaw), `angles` [rad] and `is_full_turn`; `start`, the pose of the map frame in the
    world frame; `map` with `shape` (rows, columns), `resolution` [m] and `origin` [m] in the map frame; `floor` with
    `resolution` and `origin` in the world frame; `figures`, final measures as texts by their names."""
    time: Annotated[np.ndarray, np.float32, "n"]
    """Since the reset [s]."""
    true_poses: Annotated[np.ndarray, np.float32, "n", 3]
    """x, y, heading, world frame [m, m, rad]."""
    poses: Annotated[np.ndarray, np.float32, "n", 3]
    """Estimated poses, map frame [m, m, rad]."""
    goals: Annotated[np.ndarray, np.float32, "n", 2]
    """Where to go, map frame [m]; NaN in tasks without a goal."""
    progress: Annotated[np.ndarray, np.float32, "n"]
    """How much of the task is done, from 0 to 1; of explorations the explored fraction."""
    path_length: Annotated[np.ndarray, np.float32, "n"]
    """True distance driven [m]."""
    contacts: Annotated[np.ndarray, np.int32, "n"]
    """Contacts so far."""
    scans: Annotated[np.ndarray, np.uint8, "n", "beams"]
    """Ranges of some beams, in `RANGE_STEPS` of the greatest one."""
    map_cells: Annotated[np.ndarray, np.int32, "changes"]
    """Cells that changed, as indices into the flat map, rising within a sample."""
    map_changes: Annotated[np.ndarray, np.uint8, "changes"]
    """Kinds of these cells before and after, joined by exclusive or; so it can be run backwards."""
    map_ends: Annotated[np.ndarray, np.int32, "n"]
    """End of each sample's changes."""
    plans: Annotated[np.ndarray, np.float32, "corners", 2]
    """Corners of the planned paths, map frame [m]."""
    plan_ends: Annotated[np.ndarray, np.int32, "n"]
    """End of each sample's path."""
    decision_times: Annotated[np.ndarray, np.float32, "m"]
    """When a frontier was chosen [s]."""
    decision_chosen: Annotated[np.ndarray, np.int32, "m"]
    """Index of it among the decision's candidates; -1 if the explorer went elsewhere."""
    candidates: Annotated[np.ndarray, np.float32, "candidates", len(CANDIDATE_COLUMNS)]
    """See `CANDIDATE_COLUMNS`."""
    candidate_ends: Annotated[np.ndarray, np.int32, "m"]
    """End of each decision's candidates."""
    segments: Annotated[np.ndarray, np.float32, "segments", 4]
    """True walls as (x0, y0, x1, y1), world frame [m]."""
    circles: Annotated[np.ndarray, np.float32, "circles", 3]
    """True static cylinders as (x, y, radius), world frame [m]."""
    route: Annotated[np.ndarray, np.float32, "points", 2]
    """Points of the route to follow, map frame [m]; none in tasks without one."""
    people_radii: Annotated[np.ndarray, np.float32, "people"]
    """Of people, and after them of the other robots of a team [m]."""
    people: Annotated[np.ndarray, np.float32, "n", "coordinates"]
    """Their x, y, vx, vy one after the other, world frame [m, m/s]."""
    tracks: Annotated[np.ndarray, np.float32, "tracks", 5]
    """People whom the robot tracks: x, y, vx, vy, radius, map frame [m, m/s]."""
    track_ends: Annotated[np.ndarray, np.int32, "n"]
    """End of each sample's tracks."""
    floor: Annotated[np.ndarray, np.uint8, "rows", "columns"]
    """1 where a robot can get to or see; a single 0 where the task does not tell."""

    @classmethod
    def of(cls, about: dict[str, Any], **arrays: Any) -> "Recording":
        """Return a recording of numbers of any kind; what is empty may lack its second dimension."""
        numbers = {name: np.asarray(arrays[name]).astype(kind) for name, (kind, *_) in _LAYOUT.items()}
        for name, (_, *shape) in _LAYOUT.items():
            if isinstance(width := shape[-1], int):
                numbers[name] = numbers[name].reshape(-1, width)
        return cls(about, **numbers)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their names."""
        return {name: getattr(self, name) for name in _LAYOUT}

    def to_bytes(self) -> bytes:
        """Return the content of the file; the same for the same episode."""
        archive = io.BytesIO()
        about = json.dumps(self.about | {"format": FORMAT}, allow_nan=False)
        np.savez_compressed(archive, about=np.frombuffer(about.encode(), dtype=np.uint8), **self.arrays)  # type: ignore[arg-type]
        return archive.getvalue()

    @classmethod
    def load(cls, path: Path) -> "Recording":
        """Read a file with what `to_bytes` returned.

        Raises:
            ValueError: if it is something else; names it, and says what is wrong.
            OSError: if it cannot be read.
        """
        with open_archive(path, "recorded episode", "record one with `python evaluate.py ... --record`") as archive:
            if missing := sorted({"about", *_LAYOUT} - set(archive.files)):
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
                raise ValueError(f"{name} do not count {counted}")
        rows, columns = self.about["map"]["shape"]
        if len(self.map_cells) and not 0 <= self.map_cells.min() <= self.map_cells.max() < rows * columns:
            raise ValueError("map_cells lie beside the map")


_LAYOUT: dict[str, tuple[Any, ...]] = {
    name: hint.__metadata__ for name, hint in get_type_hints(Recording, include_extras=True).items() if name != "about"
}
"""Type and shape of every array."""
