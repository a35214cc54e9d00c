"""The tables of an evaluation: a row per episode, written as it ends, and a row per episode that could not be run."""

import csv
import hashlib
import io
import json
import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from agents.run_folder import commit
from baselines.episode import Episode
from benchmarks.arena.measures import Measures
from benchmarks.arena.policies import Policy
from envs.files import naming, read_mapping, sweep, write_file

ROWS = "episodes"
"""The rows are in `episodes.csv`, those of a shard in a file of its own, `episodes-<shard>.csv`."""
FAILURES = "failures"
"""What could not be run is in `failures.csv` or `failures-<shard>.csv`."""
WORLDS = "worlds"
"""Which worlds of the user's own there are rows of is in `worlds.csv` or `worlds-<shard>.csv`."""
TRACES = "episodes"
"""Folder of the traces."""
SETTINGS_FILE = "settings.json"
"""What all rows of a folder have in common, and the versions that made the first of them."""
LIBRARIES = ("lidarnaut", "gymnasium", "numba", "numpy", "scipy", "torch")

Row = dict[str, Any]
"""One episode, by the names of `columns_of`."""
Readers = Mapping[str, Callable[[str], Any]]
"""Columns of a table and how to read their values."""


class Key(NamedTuple):
    """Identifies an episode; policy and world as given on the command line. The names are columns."""

    policy: str
    world: str
    seed: int
    robot: str
    physics: str
    slam: str
    """Of an environment with a localizer instead, that one."""


ENDING: Readers = {"end_reason": str, "duration": float, "time_limit": float, "distance_limit": float}
"""Fields of `Episode` that are the same for all tasks."""
FAILURE_COLUMNS: Readers = Key.__annotations__ | {"reason": str}
WORLD_COLUMNS: Readers = {"world": str, "source": str, "content": str}
"""Columns of `WORLDS`: what a world is called, its path or `module:attribute`, and the fingerprint of its file."""


def columns_of(measures: Measures) -> Readers:
    """Return the columns of rows: which episode, fingerprint of a learned policy's weights, measures, how it ended."""
    own = {measure.name: int if measure.is_share else float for measure in measures.all}
    return {**Key.__annotations__, "model": str, **own, **ENDING}


def make_row(policy: Policy, key: Key, episode: Episode, columns: Readers) -> Row:
    """Lay out an episode as a row."""
    known = key._asdict() | {"model": policy.model}
    known |= {name: getattr(episode, name) for name in columns if name not in known}
    return {name: read(known[name]) for name, read in columns.items()}


def key_of(row: Row) -> Key:
    """Return the key of a row's episode."""
    return Key(*(row[name] for name in Key._fields))


class Records:
    """The folder of an evaluation. Rows are appended as episodes end, so that a crash loses only unfinished ones.

    Each shard writes files of its own and reads those of all, so that machines may share a folder.
    """

    def __init__(
        self,
        folder: Path,
        columns: Readers,
        settings: dict[str, Any],
        shard: str = "",
        worlds: Mapping[str, str] | None = None,
    ) -> None:
        """Open a folder, new or from an evaluation that is to be continued.

        Args:
            folder: where.
            columns: of the rows; see `columns_of`.
            settings: what all rows must have in common.
            shard: name of the part of the evaluation that will be added, such as `1of4`; empty if it is the whole.
            worlds: paths and `module:attribute` of the user's own worlds, by what they are called in rows.

        Raises:
            ValueError: if the folder holds an evaluation with other settings or worlds, or rows that this version
                cannot read.
        """
        self.folder, self._columns, self._settings, self._shard = folder, columns, settings, shard
        self._worlds: dict[str, Row] = {
            world: {"world": world, "source": source, "content": _fingerprint(source)}
            for world, source in (worlds or {}).items()
        }
        folder.mkdir(parents=True, exist_ok=True)
        for part in (folder, folder / TRACES):
            sweep(part)
        self._check_settings()
        ending = f"-{shard}.csv" if shard else ".csv"
        self._rows_file = folder / f"{ROWS}{ending}"
        self._failures_file = folder / f"{FAILURES}{ending}"
        self._worlds_file = folder / f"{WORLDS}{ending}"
        self._read()

    def begin(self) -> None:
        """Get ready to add rows: read what other processes have added, and see that no episode is run twice.

        Raises:
            ValueError: if the folder holds other settings or worlds, shards of another total, or rows that this
                version cannot read.
        """
        self._read()
        if self._shard:
            number, _, total = self._shard.partition("of")
            names = [path.name for path in self.folder.glob(f"{ROWS}-*.csv")]
            totals = {match[1] for name in names if (match := re.fullmatch(rf"{ROWS}-\d+of(\d+)\.csv", name))}
            if others := sorted(totals - {total}):
                raise ValueError(
                    f"{self.folder} holds shards I/{', I/'.join(others)}, and --shard is {number}/{total}: episodes "
                    f"would be run twice; use I/{others[0]}, or leave out --shard"
                )
        self._check_settings()
        self._rows_file.touch()  # from now on, the folder belongs to these settings
        self._check_settings()  # another shard may have begun at the same time, with others

    def _read(self) -> None:
        self._rows = {key_of(row): row for row in read_tables(self.folder, ROWS, self._columns)}
        failures = read_tables(self.folder, FAILURES, FAILURE_COLUMNS)
        self._failures = {key_of(row): row["reason"] for row in failures}
        self._known_worlds = {row["world"]: row for row in read_tables(self.folder, WORLDS, WORLD_COLUMNS)}
        there = {key.world for key in self._rows}
        for world, own in self._worlds.items():
            known = self._known_worlds.get(world, own)
            if world in there and _identity(known) != _identity(own):
                was, now = known["source"], own["source"]
                what = f"of what {now} was before it changed" if was == now else f"of {was}, not of {now}"
                raise ValueError(
                    f"{self.folder} holds episodes in a world {world!r} {what}; give the world another name, as "
                    "LABEL=PATH, choose another --out, or remove the folder"
                )

    def find(self, policy: Policy, key: Key) -> Row | None:
        """Return the row of an episode, or None if it has not been run.

        Raises:
            ValueError: if it was run with other weights.
        """
        row = self._rows.get(key)
        if row and row["model"] != policy.model:
            raise ValueError(
                f"{self.folder} holds episodes of {policy.name} with other weights (a training has gone on?); "
                "choose another --out, or remove the folder"
            )
        return row

    def failure(self, key: Key) -> str | None:
        """Return why an episode could not be run; None if it was run since, or never tried."""
        return None if key in self._rows else self._failures.get(key)

    def add(self, row: Row) -> None:
        """Append a row and see it to the disk; before the first one in a world of the user's own, which one that is."""
        own = self._worlds.get(row["world"])
        if own and self._known_worlds.get(row["world"]) != own:
            append_row(self._worlds_file, WORLD_COLUMNS, own)
            self._known_worlds[row["world"]] = own
        append_row(self._rows_file, self._columns, row)
        self._rows[key_of(row)] = row

    def add_failure(self, key: Key, reason: str) -> None:
        """Record an episode that could not be run."""
        if self._failures.get(key) != reason:
            append_row(self._failures_file, FAILURE_COLUMNS, key._asdict() | {"reason": reason})
            self._failures[key] = reason

    def _check_settings(self) -> None:
        path, settings = self.folder / SETTINGS_FILE, self._settings
        if not path.exists() or not any(self.folder.glob(f"{ROWS}*.csv")):  # or of one that never began
            write_file(path, json.dumps(settings | {"versions": _versions()}, indent=1) + "\n")
            return
        try:
            there = json.loads(path.read_text())
            if not isinstance(there, dict):
                raise ValueError(f"holds {type(there).__name__}")
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path} is damaged: {error}; choose another --out, or remove the folder") from error
        for key, value in settings.items():
            if there.get(key) != value:
                raise ValueError(
                    f"{self.folder} holds an evaluation with {key} {there.get(key)!r}, not {value!r}; "
                    "choose another --out, or remove the folder"
                )


def write_table(path: Path, head: Iterable[Any], lines: Iterable[Iterable[Any]]) -> None:
    """Write a table as a CSV file."""
    write_file(path, "".join(map(_line, (head, *lines))))


def append_row(path: Path, columns: Readers, row: Row) -> None:
    """Append a row to a table, which gets its columns at the top if it is new, and see it to the disk."""
    content = path.read_bytes() if path.exists() else b""
    whole = content[: content.rfind(b"\n") + 1]
    with naming(path):
        if whole != content:
            # The process died while it wrote the last line: that episode runs again.
            os.truncate(path, len(whole))
        with open(path, "a", newline="") as file:
            file.write(("" if whole else _line(columns)) + _line(row[name] for name in columns))
            file.flush()
            os.fsync(file.fileno())


def _line(values: Iterable[Any]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(values)
    return line.getvalue()


def read_tables(folder: Path, name: str, columns: Readers) -> Iterator[Row]:
    """Yield the rows of all parts of a table, `<name>.csv` and `<name>-*.csv`; an incomplete last line is skipped.

    Raises:
        ValueError: if a file has other columns.
    """
    for path in sorted([*folder.glob(f"{name}.csv"), *folder.glob(f"{name}-*.csv")]):
        try:
            content = path.read_bytes().decode()
        except UnicodeDecodeError as error:
            raise ValueError(f"{path} is no table: {error}") from error
        header, *records = list(csv.reader(io.StringIO(content[: content.rfind("\n") + 1]))) or [[]]
        if header and header != list(columns):
            raise ValueError(f"{path} has other columns than this version writes; choose another --out")
        for number, record in enumerate(records, start=2):
            try:
                yield {name: read(value) for (name, read), value in zip(columns.items(), record, strict=True)}
            except ValueError as error:
                raise ValueError(
                    f"{path}, row {number}: damaged: {error}; remove the row, and it runs again"
                ) from error


def _identity(world: Row) -> str:
    return world["content"] or world["source"]


def _fingerprint(source: str) -> str:
    """Return the start of the SHA-256 of a world's file, and of the image of a map; empty if `source` is no file."""
    path = Path(source)
    if not path.is_file():
        return ""
    content, image = path.read_bytes(), read_mapping(path).get("image")
    return hashlib.sha256(content + (path.parent.joinpath(image).read_bytes() if image else b"")).hexdigest()[:12]


def _versions() -> dict[str, str]:
    versions = {"commit": commit(), "python": platform.python_version()}
    return versions | {name: version(name) for name in LIBRARIES}
