"""Error of a trajectory relative to relations (hand-verified relative poses).

Kümmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009.
"""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarnaut.envs.files import read_bytes
from lidarnaut.envs.geometry import wrap_angle

from .trajectory import between_poses

MAX_TIME_GAP = 0.3
"""Maximum time between the stamps of a reference relative pose and the nearest trajectory poses [s]."""


@dataclass(frozen=True, slots=True)
class RelationError:
    """Error of a trajectory's relative poses, compared with reference relative poses."""

    translation: float
    translation_std: float
    """Standard deviation of translation errors [m]; `translation` is the mean."""
    rotation: float
    rotation_std: float
    """Standard deviation of rotation errors [deg]; `rotation` is the mean."""
    count: int

    def __str__(self) -> str:
        translation = f"{self.translation:.3f} +- {self.translation_std:.3f} m"
        return f"{translation}, {self.rotation:.2f} +- {self.rotation_std:.2f} deg over {self.count} relations"


def load_relations(path: str | Path) -> np.ndarray:
    """Read relations (reference relative poses), one per line: `t1 t2 x y z roll pitch yaw`.

    Returns:
        t1, t2 [s], and x, y [m], yaw [rad] of the second pose relative to the first: shape (n, 5), float64.

    Raises:
        ValueError: a line lacks eight finite numbers, or the file is a trajectory in TUM format.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(io.BytesIO(read_bytes(Path(path))), ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: not a list of relations: {error}") from error
    if table.size == 0:
        raise ValueError(f"{path}: holds no relations")
    if table.shape[1] != 8:
        wanted = "8 numbers per line (t1 t2 x y z roll pitch yaw)"
        raise ValueError(f"{path}: relations have {wanted}, got {table.shape[1]}")
    if not (finite := np.isfinite(table).all(axis=1)).all():
        raise ValueError(f"{path}: relation {int(finite.argmin())} is not finite")
    if len(table) > 2 and np.allclose(np.linalg.norm(table[:, 4:], axis=1), 1.0, rtol=0.0, atol=1e-4):
        wanted = "relations have t1 t2 x y z roll pitch yaw per line"
        raise ValueError(f"{path}: a trajectory in TUM format (the last four numbers are quaternions); {wanted}")
    return table[:, [0, 1, 2, 3, 7]]


def load_labelled(path: str | Path) -> dict[str, np.ndarray]:
    """Read sets of reference relative poses by name: all (`relation error`), and an optional subset (`unambiguous`).

    The file `unambiguous_relations.npy` in the same folder, a boolean mask, selects the subset.

    Raises:
        ValueError: a file is damaged.
    """
    relations, mask_path = load_relations(path), Path(path).parent / "unambiguous_relations.npy"
    if not mask_path.is_file():
        return {"relation error": relations}
    try:
        mask = np.lib.format.read_array(io.BytesIO(read_bytes(mask_path)))
    except Exception as error:  # many types
        raise ValueError(f"{mask_path}: damaged or not an array: {' '.join(str(error).split())}") from error
    if mask.shape != (len(relations),) or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(f"{mask_path}: must be a mask of {len(relations)} relations, got {mask.dtype} {mask.shape}")
    return {"relation error": relations, "unambiguous": relations[mask]}


def relation_error(times: np.ndarray, poses: np.ndarray, relations: np.ndarray) -> RelationError:
    """Compare a trajectory, `times` [s] and `poses` [m, m, rad], with `relations` (reference relative poses).

    Raises:
        ValueError: no relation lies within the trajectory's time.
    """
    rows = np.stack([_nearest(times, relations[:, 0]), _nearest(times, relations[:, 1])], axis=1)
    known = (np.abs(times[rows] - relations[:, :2]) <= MAX_TIME_GAP).all(axis=1)
    if not known.any():
        raise ValueError("no relation lies within the trajectory's time; do they belong to another log?")
    truth = relations[known, 2:]
    estimated = between_poses(poses[rows[known, 0]], poses[rows[known, 1]])
    translation = np.hypot(*(estimated - truth)[:, :2].T)
    rotation = np.degrees(np.abs(wrap_angle(estimated[:, 2] - truth[:, 2])))
    numbers = float(translation.mean()), float(translation.std()), float(rotation.mean()), float(rotation.std())
    return RelationError(*numbers, len(truth))


def _nearest(times: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    order = np.argsort(times, kind="stable")  # clocks may jump back
    times = times[order]
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return order[np.where(wanted - times[after - 1] <= times[after] - wanted, after - 1, after)]
