"""The folder of a run: what is written when it opens, its checkpoints, and its table of evaluations."""

import contextlib
import csv
import io
import json
import platform
import re
import shutil
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lidarnaut.agents.config import EvolutionConfig, TrainingConfig
from lidarnaut.agents.curves import Row, draw_learning_curve
from lidarnaut.envs.files import Lock, dump_record, own_folder, read_bytes, write_file

LIBRARIES = ("torch", "stable-baselines3", "gymnasium", "numba", "numpy")
"""Libraries whose versions a run records."""
GENERATIONS = "generations.csv"
"""File of a run of evolution: the values of all individuals."""
VERSIONS = "versions.json"
"""File of a run: the versions of the libraries that began it."""
SWEEP = "sweep.yaml"
"""File of the folder of a sweep: the configuration of all its runs."""
RECORD_FILE = "checkpoint.json"
"""File of a checkpoint: everything that is not a tensor."""


class CheckpointError(RuntimeError):
    """A checkpoint cannot be written, read or used; the message names it, the reason, and the remedy."""


def list_checkpoints(run: Path) -> list[Path]:
    """Return the checkpoint folders of a run, oldest first."""
    return sorted(path for path in (run / "checkpoints").glob("step_*") if re.fullmatch(r"step_\d+", path.name))


def count_done(path: Path) -> int:
    """Return the generations of a run of evolution, or the steps of a checkpoint or of a run's newest; 0 if unknown."""
    if (path / GENERATIONS).exists():
        return read_bytes(path / GENERATIONS).count(b"\n")
    names = [path.name, *(one.name for one in list_checkpoints(path))]
    return max((int(name[5:]) for name in names if re.fullmatch(r"step_\d+", name)), default=0)


def find_checkpoint(path: str | Path) -> Path:
    """Return the checkpoint that a run folder or a checkpoint folder means; CheckpointError if there is none."""
    path = Path(path)
    if path.is_dir() and (re.fullmatch(r"step_\d+", path.name) or (path / RECORD_FILE).exists()):
        return path
    if found := list_checkpoints(path):
        return found[-1]
    what = "is neither a run folder nor a checkpoint folder" if path.is_dir() else "is no folder"
    raise CheckpointError(f"{path} {what}; a run folder has checkpoints/step_<number>/ in it")


def find_config(path: str | Path) -> Path:
    """Return the configuration of a run, a checkpoint or a sweep by its folder; CheckpointError if there is none."""
    path = Path(path)
    if (path / SWEEP).exists():
        return path / SWEEP
    run = path if (path / GENERATIONS).exists() else find_checkpoint(path).parent.parent
    return run / "config.yaml"


@contextlib.contextmanager
def new_run(config: TrainingConfig | EvolutionConfig, run: Path | None) -> Iterator[Path]:
    """Create a run folder with the resolved configuration in it; None makes `runs/<experiment>__<seed>__<time>`.

    The folder is locked until the context ends.

    Raises:
        ValueError: if the folder holds a run already.
        lidarnaut.envs.files.LockedError: if another process is at it.
    """
    run = run or Path("runs") / f"{config.experiment}__{config.seed}__{time.strftime('%Y%m%d-%H%M%S')}"
    with Lock(own_folder(run)):
        if list_checkpoints(run) or (run / GENERATIONS).exists():
            raise ValueError(f"{run} holds a run already; go on with it by --resume {run}, or choose another folder")
        prepare_folder(run, config)
        yield run


def prepare_folder(run: Path, config: TrainingConfig | EvolutionConfig) -> None:
    """Write the configuration and the versions into a locked folder of a run."""
    versions = {name: version(name) for name in LIBRARIES}
    versions |= {"python": platform.python_version(), "platform": platform.platform(), "commit": commit()}
    write_file(run / "config.yaml", dump_record(config))
    write_file(run / VERSIONS, json.dumps(versions, indent=1) + "\n")


def discard_after(checkpoint: Path) -> Path:
    """Rename what is newer than a checkpoint to `*.discarded`, in a run that is locked; return the run's folder."""
    run = checkpoint.parent.parent
    for newer in list_checkpoints(run):
        if newer.name > checkpoint.name:
            aside = newer.with_name(newer.name + ".discarded")
            shutil.rmtree(aside, ignore_errors=True)
            newer.rename(aside)
    return run


def write_evaluations(run: Path, rows: Sequence[Row], title: str, axis: str = "environment steps") -> None:
    """Write the evaluations so far as `evaluations.csv` and as `learning_curve.png`, with `title` above the curve."""
    write_table(run / "evaluations.csv", rows)
    draw_learning_curve({str(rows[-1]["policy"]): rows}, title, run / "learning_curve.png", axis)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV; where one lacks a column of another, it holds NaN."""
    table = io.StringIO()
    writer = csv.DictWriter(table, list(dict.fromkeys(key for row in rows for key in row)), "nan", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_file(path, table.getvalue())


def commit() -> str:
    """Return the commit of the checkout that this code lies in, with "+" where it has been changed since."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=12", "--dirty=+"]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"
