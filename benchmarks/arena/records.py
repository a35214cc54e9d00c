"""The table of an evaluation: a row per episode, written as it ends."""

import csv
import io
import json
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from agents.files import write_file
from baselines.episode import Episode
from benchmarks.arena.policies import Policy

ROWS_FILE = "episodes.csv"
"""The rows."""
SETTINGS_FILE = "settings.json"
"""What all rows of a folder have in common, and the versions that made the first of them."""
LIBRARIES = ("lidarnaut", "gymnasium", "numba", "numpy", "scipy", "torch")
"""Libraries whose versions are kept."""

Row = dict[str, Any]
"""One episode, by the names of `COLUMNS`."""

_READERS: dict[Any, Callable[[str], Any]] = {float: float, int: int, bool: int, str: str}

COLUMNS: dict[str, Callable[[str], Any]] = {
    "policy": str,
    "world": str,
    "seed": int,
    "robot": str,
    "model": str,
    **{field.name: _READERS[field.type] for field in fields(Episode) if field.name != "curve"},
}
"""Columns of the rows and how to read their values: which episode (policy and world as given on the command line, seed,
robot, fingerprint of a learned policy's weights), then the fields of `Episode`."""


def make_row(policy: Policy, world: str, seed: int, robot: str, episode: Episode) -> Row:
    """Lay out an episode as a row."""
    row = {"policy": policy.name, "world": world, "seed": seed, "robot": robot, "model": policy.fingerprint[:12]}
    return row | {name: COLUMNS[name](getattr(episode, name)) for name in COLUMNS if name not in row}


class Records:
    """The folder of an evaluation. Rows are appended as episodes end, so that a crash loses only those under way."""

    def __init__(self, folder: Path, settings: dict[str, Any]) -> None:
        """Open a folder, new or from an evaluation that is to be continued.

        Args:
            folder: where.
            settings: what all rows must have in common.

        Raises:
            ValueError: if the folder holds an evaluation with other settings, or rows that this version cannot read.
        """
        self.folder = folder
        self._rows: dict[tuple[str, str, int], Row] = {}
        folder.mkdir(parents=True, exist_ok=True)
        self._check_settings(settings)
        if (folder / ROWS_FILE).exists():
            self._read(folder / ROWS_FILE)
        else:
            self._append(COLUMNS)

    def find(self, policy: Policy, world: str, seed: int) -> Row | None:
        """Return the row of an episode, or None if it has not been run.

        Raises:
            ValueError: if it was run with other weights.
        """
        row = self._rows.get((policy.name, world, seed))
        if row and row["model"] != policy.fingerprint[:12]:
            raise ValueError(
                f"{self.folder} holds episodes of {policy.name} with other weights (a training has gone on?); "
                "choose another --out, or remove the folder"
            )
        return row

    def add(self, row: Row) -> None:
        """Append a row and see it to the disk."""
        self._append(row[name] for name in COLUMNS)
        self._keep(row)

    def _keep(self, row: Row) -> None:
        self._rows[row["policy"], row["world"], row["seed"]] = row

    def _append(self, values: Iterable[Any]) -> None:
        with open(self.folder / ROWS_FILE, "a", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(values)
            file.flush()
            os.fsync(file.fileno())

    def _read(self, path: Path) -> None:
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            # The process died while it wrote the last line: that episode runs again.
            os.truncate(path, len(whole))
        if not whole:
            self._append(COLUMNS)
            return
        header, *records = csv.reader(io.StringIO(whole.decode()))
        if header != list(COLUMNS):
            raise ValueError(f"{path} has other columns than this version writes; choose another --out")
        for record in records:
            self._keep({name: read(value) for (name, read), value in zip(COLUMNS.items(), record, strict=True)})

    def _check_settings(self, settings: dict[str, Any]) -> None:
        path = self.folder / SETTINGS_FILE
        if not path.exists():
            write_file(path, json.dumps(settings | {"versions": _versions()}, indent=1) + "\n")
            return
        there = json.loads(path.read_text())
        for key, value in settings.items():
            if there.get(key) != value:
                raise ValueError(
                    f"{self.folder} holds an evaluation with {key} {there.get(key)!r}, not {value!r}; "
                    "choose another --out, or remove the folder"
                )


def _versions() -> dict[str, str]:
    return {"python": platform.python_version()} | {name: version(name) for name in LIBRARIES}
