"""The file of a recorded episode: a compressed NumPy archive."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.files import open_archive

FORMAT = 2
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

_LAYOUT: Mapping[str, tuple[type, int]] = {
    "time": (np.float32, 1),
    "true_poses": (np.float32, 2),
    "poses": (np.float32, 2),
    "goals": (np.float32, 2),
    "progress": (np.float32, 1),
    "path_length": (np.float32, 1),
    "contacts": (np.int32, 1),
    "scans": (np.uint8, 2),
    "map_cells": (np.int32, 1),
    "map_changes": (np.uint8, 1),
    "map_ends": (np.int32, 1),
    "plans": (np.float32, 2),
    "plan_ends": (np.int32, 1),
    "decision_times": (np.float32, 1),
    "decision_chosen": (np.int32, 1),
    "candidates": (np.float32, 2),
    "candidate_ends": (np.int32, 1),
    "segments": (np.float32, 2),
    "circles": (np.float32, 2),
    "route": (np.float32, 2),
    "mover_radii": (np.float32, 1),
    "movers": (np.float32, 2),
    "floor": (np.uint8, 2),
}
"""Type and dimensions of every array."""
_WIDTHS = {"true_poses": 3, "poses": 3, "goals": 2, "plans": 2, "route": 2, "segments": 4, "circles": 3}
_WIDTHS["candidates"] = len(CANDIDATE_COLUMNS)
_RAGGED = {"map_ends": "map_cells", "plan_ends": "plans", "candidate_ends": "candidates"}
"""Ends of what belongs to each sample, or decision, and the array that they count in."""
_SAMPLED = ("true_poses", "poses", "goals", "progress", "path_length", "contacts", "scans", "map_ends", "plan_ends")
_DECIDED = ("decision_chosen", "candidate_ends")


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The course of an episode, n samples of one robot and m decisions. Frames and units are in each field."""

    about: dict[str, Any]
    """What is said once, as JSON: `explorer`, `world`, `robot`, `seed`, `end_reason`; what `progress` is called;
    `radius` [m]; `lidar` with
    `range_max` [m], `mount` (x, y, yaw), `angles` [rad] and `is_full_turn`; `start`, the pose of the map frame in the
    world frame; `map` with `shape` (rows, columns), `resolution` [m] and `origin` [m] in the map frame; `floor` with
    `resolution` and `origin` in the world frame; `figures`, final measures as texts by their names."""
    time: np.ndarray
    """Shape (n,), float32, since the reset [s]."""
    true_poses: np.ndarray
    """Shape (n, 3), float32: x, y, heading, world frame [m, m, rad]."""
    poses: np.ndarray
    """Shape (n, 3), float32: estimated poses, map frame [m, m, rad]."""
    goals: np.ndarray
    """Shape (n, 2), float32: where to go, map frame [m]; NaN in tasks without a goal."""
    progress: np.ndarray
    """Shape (n,), float32: how much of the task is done, from 0 to 1; of explorations the explored fraction."""
    path_length: np.ndarray
    """Shape (n,), float32: true distance driven [m]."""
    contacts: np.ndarray
    """Shape (n,), int32: contacts so far."""
    scans: np.ndarray
    """Shape (n, b), uint8: ranges of some beams, in `RANGE_STEPS` of the greatest one."""
    map_cells: np.ndarray
    """Shape (e,), int32: cells that changed, as indices into the flat map, rising within a sample."""
    map_changes: np.ndarray
    """Shape (e,), uint8: kinds of these cells before and after, joined by exclusive or; so it can be run backwards."""
    map_ends: np.ndarray
    """Shape (n,), int32: end of each sample's changes."""
    plans: np.ndarray
    """Shape (p, 2), float32: corners of the planned paths, map frame [m]."""
    plan_ends: np.ndarray
    """Shape (n,), int32: end of each sample's path."""
    decision_times: np.ndarray
    """Shape (m,), float32: when a frontier was chosen [s]."""
    decision_chosen: np.ndarray
    """Shape (m,), int32: index of it among the decision's candidates; -1 if the explorer went elsewhere."""
    candidates: np.ndarray
    """Shape (c, 6), float32, see `CANDIDATE_COLUMNS`."""
    candidate_ends: np.ndarray
    """Shape (m,), int32: end of each decision's candidates."""
    segments: np.ndarray
    """Shape (k, 4), float32: true walls as (x0, y0, x1, y1), world frame [m]."""
    circles: np.ndarray
    """Shape (j, 3), float32: true static cylinders as (x, y, radius), world frame [m]."""
    route: np.ndarray
    """Shape (r, 2), float32: points of the route to follow, map frame [m]; none in tasks without one."""
    mover_radii: np.ndarray
    """Shape (l,), float32: of the bodies that move, the other robots of a team among them [m]."""
    movers: np.ndarray
    """Shape (n, 2 l), float32: their positions x, y one after the other, world frame [m]."""
    floor: np.ndarray
    """Shape (rows, columns), uint8: 1 where a robot can get to or see; a single 0 where the task does not tell."""

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
        try:
            with open_archive(path) as archive:
                if missing := sorted({"about", *_LAYOUT} - set(archive.files)):
                    raise ValueError(f"it lacks {', '.join(missing[:3])}{', ...' * (len(missing) > 3)}")
                about = json.loads(archive["about"].tobytes())
                recording = cls(about, **{name: archive[name] for name in _LAYOUT})
            recording._check()
        except OSError:
            raise
        except Exception as error:  # NumPy, zipfile and zlib raise many kinds
            said = " ".join(str(error).split()) or type(error).__name__
            hint = "record one with `python evaluate.py ... --record`"
            raise ValueError(f"{path} is no recorded episode ({said}); {hint}") from error
        return recording

    def _check(self) -> None:
        if self.about["format"] != FORMAT:
            raise ValueError(f"it has format {self.about['format']}, this version reads {FORMAT}")
        for name, (dtype, dimensions) in _LAYOUT.items():
            array = getattr(self, name)
            if array.dtype != dtype or array.ndim != dimensions:
                raise ValueError(f"{name} is {array.dtype} in {array.ndim} dimensions")
            if name in _WIDTHS and array.shape[1] != _WIDTHS[name]:
                raise ValueError(f"{name} has {array.shape[1]} columns")
        if not len(self.time):
            raise ValueError("it has no samples")
        lengths = {name: len(self.time) for name in (*_SAMPLED, "movers")} | {
            name: len(self.decision_times) for name in _DECIDED
        }
        lengths |= {"map_changes": len(self.map_cells)}
        for name, length in lengths.items():
            if len(getattr(self, name)) != length:
                raise ValueError(f"{name} has {len(getattr(self, name))} rows, not {length}")
        for name, counted in _RAGGED.items():
            ends = np.concatenate([[0], getattr(self, name)])
            if (np.diff(ends) < 0).any() or ends[-1] != len(getattr(self, counted)):
                raise ValueError(f"{name} do not count {counted}")
        rows, columns = self.about["map"]["shape"]
        if len(self.map_cells) and not 0 <= self.map_cells.min() <= self.map_cells.max() < rows * columns:
            raise ValueError("map_cells lie beside the map")
