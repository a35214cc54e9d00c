"""The folder of an evaluation: a row per episode, written as it ends, and a row per episode that could not be run."""

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

from lidarnaut.agents.run_folder import commit
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.envs.files import append_file, naming, own_folder, read_bytes, read_json, read_mapping, write_file

SETTINGS_FILE = "settings.json"
"""What all rows of a folder have in common, and the versions that made the first of them."""
MAX_TABLE_BYTES = 64 * 2**20
"""Largest table that is read."""
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
    people: str = "0"
    """How many people walk around."""

    @classmethod
    def of(cls, row: Row) -> "Key":
        """Return the key of a row's episode."""
        return cls(*(row[name] for name in cls._fields))


def columns_of(measures: Measures) -> Readers:
    """Return the columns of rows: which episode, fingerprint of a learned policy's weights, measures, how it ended."""
    own = {measure.name: int if measure.is_share else float for measure in measures.all}
    ending = {"end_reason": str, "duration": float, "time_limit": float, "distance_limit": float}
    return {**Key.__annotations__, "model": str, **own, **ending}


class Records:
    """The folder of an evaluation. Rows are appended as episodes end, so that a crash loses only unfinished ones.

    Each shard writes files of its own, `episodes-1of4.csv`, and reads all: machines may share a folder.
    """

    def __init__(
        self,
        folder: Path,
        columns: Readers,
        settings: dict[str, Any],
        shard: str = "",
        worlds: Mapping[str, str] | None = None,
    ) -> None:
        """Open a folder, new or from an evaluation that is to be continued, for rows with `settings` in common.

        `shard` is the part that will be added, such as `1of4`; empty for the whole. `worlds` are paths and
        `module:attribute` of the user's own worlds, by what they are called in rows.

        Raises:
            ValueError: if the folder holds an evaluation with other settings or worlds, or rows that this version
                cannot read.
        """
        self.folder, self._settings, self._shard = folder, settings, shard
        self._episodes = _Table(folder, "episodes", columns, shard)
        self._reasons = _Table(folder, "failures", Key.__annotations__ | {"reason": str}, shard)
        self._worlds = _Table(folder, "worlds", {"world": str, "source": str, "content": str}, shard)
        self._own_worlds: dict[str, Row] = {
            world: {"world": world, "source": source, "content": _fingerprint(source)}
            for world, source in (worlds or {}).items()
        }
        own_folder(folder)
        self._check_settings()
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
            names = " ".join(path.name for path in self.folder.glob("episodes-*.csv"))
            if others := sorted(set(re.findall(r"episodes-\d+of(\d+)\.csv", names)) - {total}):
                raise ValueError(
                    f"{self.folder} holds shards I/{', I/'.join(others)}, and --shard is {number}/{total}: episodes "
                    f"would be run twice; use I/{others[0]}, or leave out --shard"
                )
        self._check_settings()
        self._episodes.path.touch()  # from now on, the folder belongs to these settings
        self._check_settings()  # another shard may have begun at the same time, with others

    def _read(self) -> None:
        self._rows = {Key.of(row): row for row in self._episodes.read()}
        self._failures = {Key.of(row): row["reason"] for row in self._reasons.read()}
        self._known_worlds = {row["world"]: row for row in self._worlds.read()}
        there = {key.world for key in self._rows}
        for world, own in self._own_worlds.items():
            known = self._known_worlds.get(world, own)
            if world in there and (known["content"] or known["source"]) != (own["content"] or own["source"]):
                was, now = known["source"], own["source"]
                what = f"of what {now} was before it changed" if was == now else f"of {was}, not of {now}"
                raise ValueError(
                    f"{self.folder} holds episodes in a world {world!r} {what}; give the world another name, as "
                    "LABEL=PATH, choose another --out, or remove the folder"
                )

    def find(self, key: Key, model: str = "") -> Row | None:
        """Return the row of an episode, or None; ValueError if it was run with other weights than those of `model`."""
        row = self._rows.get(key)
        if row and row["model"] != model:
            raise ValueError(
                f"{self.folder} holds episodes of {key.policy} with other weights (a training has gone on?); "
                "choose another --out, or remove the folder"
            )
        return row

    def failure(self, key: Key) -> str | None:
        """Return why an episode could not be run; None if it was run since, or never tried."""
        return None if key in self._rows else self._failures.get(key)

    def add(self, row: Row) -> None:
        """Append a row and see it to the disk; before the first one in a world of the user's own, which one that is."""
        own = self._own_worlds.get(row["world"])
        if own and self._known_worlds.get(row["world"]) != own:
            self._worlds.append(own)
            self._known_worlds[row["world"]] = own
        self._episodes.append(row)
        self._rows[Key.of(row)] = row

    def add_failure(self, key: Key, reason: str) -> None:
        """Record an episode that could not be run."""
        if self._failures.get(key) != reason:
            self._reasons.append(key._asdict() | {"reason": reason})
            self._failures[key] = reason

    def _check_settings(self) -> None:
        path = self.folder / SETTINGS_FILE
        if not path.exists() or not any(self.folder.glob("episodes*.csv")):  # or of one that never began
            versions = {"commit": commit(), "python": platform.python_version()}
            versions |= {name: version(name) for name in LIBRARIES}
            write_file(path, json.dumps(self._settings | {"versions": versions}, indent=1) + "\n")
            return
        try:
            there = read_json(path)
        except ValueError as error:
            raise ValueError(f"{error}; choose another --out, or remove the folder") from error
        for key, value in self._settings.items():
            if there.get(key) != value:
                raise ValueError(
                    f"{self.folder} holds an evaluation with {key} {there.get(key)!r}, not {value!r}; "
                    "choose another --out, or remove the folder"
                )


class _Table:
    """A CSV table in one part per shard: all are read, and rows are appended to one's own."""

    def __init__(self, folder: Path, name: str, columns: Readers, shard: str) -> None:
        self._folder, self._name, self._columns = folder, name, columns
        self.path = folder / (f"{name}-{shard}.csv" if shard else f"{name}.csv")

    def read(self) -> Iterator[Row]:
        """Yield the rows of all parts; an incomplete last line is skipped."""
        for path in sorted([*self._folder.glob(f"{self._name}.csv"), *self._folder.glob(f"{self._name}-*.csv")]):
            yield from read_table(path, self._columns)

    def append(self, row: Row) -> None:
        """Append a row, below the columns if the table is new, and see it to the disk."""
        content = read_bytes(self.path) if self.path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        with naming(self.path):
            if whole != content:
                # The process died while it wrote the last line: that episode runs again.
                os.truncate(self.path, len(whole))
        lines = [row[name] for name in self._columns]
        append_file(self.path, _lines([lines] if whole else [self._columns, lines]))


def read_table(path: Path, columns: Readers) -> Iterator[Row]:
    """Yield the rows of a table, but for an incomplete last line; ValueError if damaged, or of other columns."""
    try:
        content = read_bytes(path, MAX_TABLE_BYTES).decode()
        header, *records = list(csv.reader(io.StringIO(content[: content.rfind("\n") + 1]))) or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is no table: {error}") from error
    if header and header != list(columns):
        raise ValueError(f"{path} has other columns than this version writes; choose another --out")
    for number, record in enumerate(records, start=2):
        try:
            yield {name: read(value) for (name, read), value in zip(columns.items(), record, strict=True)}
        except ValueError as error:
            raise ValueError(f"{path}, row {number}: damaged: {error}; remove the row, and it runs again") from error


def write_table(path: Path, head: Iterable[Any], lines: Iterable[Iterable[Any]]) -> None:
    """Write a table as a CSV file."""
    write_file(path, _lines([head, *lines]))


def _lines(lines: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def _fingerprint(source: str) -> str:
    """Return the start of the SHA-256 of a world's file, and of the image of a map; empty if `source` is no file."""
    path = Path(source)
    if not path.is_file():
        return ""
    content, image = read_bytes(path), read_mapping(path).get("image")
    return hashlib.sha256(content + (read_bytes(path.parent.joinpath(image)) if image else b"")).hexdigest()[:12]
