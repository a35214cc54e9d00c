"""Logs of real robots: reading them, and judging trajectories along them."""

from pathlib import Path

from .arrays import read_arrays
from .carmen import read_carmen
from .log import Log
from .relations import RelationError, load_relations, relation_error
from .trajectory import compose_poses, follow_odometry, pose_errors, rms, save_trajectory


def load_log(path: str | Path, max_range: float | None = None) -> Log:
    """Read a log, either arrays (.npz) or CARMEN text (.log, .log.gz, .clf).

    Args:
        path: the file. Arrays are named `t`, `odo`, `ranges`, `idx`, `ang0`, `dang`, `maxr` and optionally `off`, which
            is added to `t`.
        max_range: readings from this on count as no return [m]; None takes what the log says.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is of another kind, damaged, or holds no scans.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no log at {path}")
    if path.suffix == ".npz":
        return read_arrays(path, max_range)
    if path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")):
        return read_carmen(path, max_range)
    raise ValueError(f"{path}: unknown kind of log; .npz, .log, .log.gz, .clf and .clf.gz are known")


__all__ = [
    "Log",
    "RelationError",
    "compose_poses",
    "follow_odometry",
    "load_log",
    "load_relations",
    "pose_errors",
    "relation_error",
    "rms",
    "save_trajectory",
]
