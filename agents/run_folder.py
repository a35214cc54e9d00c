"""Run folders: configuration, checkpoints and evaluation tables."""

import contextlib
import csv
import io
import json
import logging
import platform
import re
import shutil
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lidarnaut.agents.config import Config
from lidarnaut.agents.curves import Row, draw_learning_curve, read_evaluations, result_of
from lidarnaut.envs.files import Lock, dump_record, explain_unknown, own_folder, read_bytes, read_json, write_file

LIBRARIES = ("torch", "stable-baselines3", "gymnasium", "numba", "numpy")
GENERATIONS = "generations.csv"
VERSIONS = "versions.json"
SWEEP = "sweep.yaml"
RECORD_FILE = "checkpoint.json"
BEST = "best.json"
"""File in `checkpoints` that names the step of the best checkpoint by the validation episodes."""
LOGGER = logging.getLogger(__name__)


class CheckpointError(RuntimeError):
    """Error for a checkpoint that cannot be written, read or used."""


def list_checkpoints(run: Path) -> list[Path]:
    """Return the checkpoint folders of a run, oldest first."""
    return sorted(path for path in (run / "checkpoints").glob("step_*") if re.fullmatch(r"step_\d+", path.name))


def count_done(path: Path) -> int:
    """Return the number of finished generations (evolution), or of steps at the newest checkpoint."""
    if (path / GENERATIONS).exists():
        return read_bytes(path / GENERATIONS).count(b"\n")
    names = [path.name, *(one.name for one in list_checkpoints(path))]
    return max((int(name[5:]) for name in names if re.fullmatch(r"step_\d+", name)), default=0)


def find_best(run: Path) -> Path | None:
    """Return the best checkpoint folder of a run by the validation episodes; None if unknown."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, OverflowError):
        path = run / "checkpoints" / f"step_{int(read_json(run / 'checkpoints' / BEST)['step']):09d}"
        return path if path.is_dir() else None
    return None


def find_checkpoint(path: str | Path, which: str = "last") -> Path:
    """Return a checkpoint folder.

    `path`: checkpoint folder, or run folder, also followed by `@best`, `@last` or `@STEP`. `which`: checkpoint of a run
    folder without such an ending; without a best one, the last.

    Raises:
        CheckpointError: if there is no such checkpoint.
    """
    run, at, ending = str(path).rpartition("@")
    path, which = (Path(run), ending) if at and not Path(path).exists() else (Path(path), which)
    if path.is_dir() and (re.fullmatch(r"step_\d+", path.name) or (path / RECORD_FILE).exists()):
        return path
    if found := {str(int(one.name[5:])): one for one in list_checkpoints(path)}:
        best = find_best(path)
        named = {**found, "last": [*found.values()][-1], "best": best or [*found.values()][-1]}
        if which not in named:
            raise CheckpointError(f"{path} has no checkpoint {explain_unknown(which, ['best', 'last', *found])}")
        if which == "best":
            why = "the best in the validation episodes" if best else "the last, since none is marked as the best"
            LOGGER.info("%s: checkpoint of step %d, %s", path, int(named[which].name[5:]), why)
        return named[which]
    what = "is neither a run folder nor a checkpoint folder" if path.is_dir() else "is not a folder"
    raise CheckpointError(f"{path} {what}; a run folder contains checkpoints/step_<number>/")


def find_config(path: str | Path) -> Path:
    """Return the configuration file of a run, checkpoint or sweep; raise CheckpointError if missing."""
    path = Path(path)
    if (path / SWEEP).exists():
        return path / SWEEP
    run = path if (path / GENERATIONS).exists() else find_checkpoint(path).parent.parent
    return run / "config.yaml"


@contextlib.contextmanager
def new_run(config: Config, run: Path | None) -> Iterator[Path]:
    """Create and lock a run folder, by default `runs/<experiment>__<seed>__<time>`.

    Raises:
        ValueError: if the folder already holds a run.
        lidarnaut.envs.files.LockedError: if another process uses the folder.
    """
    run = run or _new_folder(f"{config.experiment}__{config.seed}__{time.strftime('%Y%m%d-%H%M%S')}")
    with Lock(own_folder(run)):
        if list_checkpoints(run) or (run / GENERATIONS).exists():
            raise ValueError(f"{run} already holds a run; resume it with --resume {run}, or choose another folder")
        prepare_folder(run, config)
        yield run


def _new_folder(name: str) -> Path:
    """Create `runs/<name>`, or `runs/<name>-2` and so on if another training has begun in the same second."""
    folder, number = Path("runs") / name, 1
    while True:
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1
            folder = folder.with_name(f"{name}-{number}")


def prepare_folder(run: Path, config: Config) -> None:
    """Write configuration and versions of libraries to a run folder."""
    versions = {name: version(name) for name in LIBRARIES}
    versions |= {"python": platform.python_version(), "platform": platform.platform(), "commit": commit()}
    write_file(run / "config.yaml", dump_record(config))
    write_file(run / VERSIONS, json.dumps(versions, indent=1) + "\n")


def discard_after(checkpoint: Path) -> Path:
    """Rename checkpoints newer than the resumed `checkpoint` to `*.discarded`; return the run folder."""
    run = checkpoint.parent.parent
    for newer in list_checkpoints(run):
        if newer.name > checkpoint.name:
            aside = newer.with_name(newer.name + ".discarded")
            shutil.rmtree(aside, ignore_errors=True)
            newer.rename(aside)
    return run


def is_measured(run: Path) -> bool:
    """Return True if the evaluations of a run hold its result on the test episodes."""
    try:
        return result_of(read_evaluations(run)) is not None
    except (OSError, ValueError):
        return False


def write_evaluations(run: Path, rows: Sequence[Row], title: str, axis: str = "environment steps") -> None:
    """Write the evaluation table `evaluations.csv` and its plot to a run folder."""
    write_table(run / "evaluations.csv", rows)
    draw_learning_curve(rows, title, run / "learning_curve.png", axis)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write mappings from column to value as CSV, with NaN for missing columns."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    write_file(path, csv_text([columns, *([row.get(name, "nan") for name in columns] for row in rows)]))


def csv_text(lines: Iterable[Iterable[Any]]) -> str:
    """Return lines of values as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def commit() -> str:
    """Return the git commit of this code, with "+" for local changes."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=12", "--dirty=+"]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"
