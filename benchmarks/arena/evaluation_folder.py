"""Evaluation folder: CSV tables of finished and failed episodes."""

import csv
import hashlib
import io
import json
import math
import os
import platform
import re
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from lidarnaut.agents.run_folder import commit, csv_text
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.envs.files import append_file, naming, own_folder, read_bytes, read_json, read_mapping, write_file

SETTINGS_FILE = "settings.json"
MAX_TABLE_BYTES = 64 * 2**20
LIBRARIES = ("lidarnaut", "gymnasium", "numba", "numpy", "scipy", "torch")

Row = dict[str, Any]
"""Results of an episode by column name of `episodes.csv`."""
Readers = Mapping[str, Callable[[str], Any]]
"""Functions that parse the text of a CSV cell, by column name."""


class Key(NamedTuple):
    """Identifier of an episode in `episodes.csv`: policy, conditions and seed."""

    policy: str
    world: str
    seed: int
    robot: str
    physics: str
    slam: str
    people: str = "0"

    @classmethod
    def of(cls, row: Row) -> "Key":
        return cls(*(row[name] for name in cls._fields))


def columns_of(measures: Measures) -> Readers:
    """Return the columns of `episodes.csv`, each with a function that parses its text."""
    own = {one.name: _number if one.limit or one.is_headline else float for one in measures.all}
    own |= {one.name: _share for one in measures.all if one.is_share}
    ending = {"end_reason": str, **dict.fromkeys(("duration", "time_limit", "distance_limit"), _number)}
    return {**Key.__annotations__, "model": str, **own, **ending}


def _share(value: Any) -> int:
    if (number := int(value)) not in (0, 1):
        raise ValueError(f"{value!r} is neither 0 nor 1")
    return number


def _number(value: Any) -> float:
    if math.isnan(number := float(value)):
        raise ValueError("nan is allowed in measures without rank only")
    return number


class Records:
    """Results in an evaluation folder: one CSV row per episode, appended as soon as the episode ends.

    Machines that share the folder run parts (shards), write separate files such as `episodes-1of4.csv`, and read all
    files.
    """

    def __init__(
        self,
        folder: Path,
        columns: Readers,
        settings: dict[str, Any],
        shard: str = "",
        worlds: Mapping[str, str] | None = None,
    ) -> None:
        """Open a new or existing folder; ValueError if it has other settings or worlds, or unreadable rows.

        `settings`: common to all episodes. `shard`: part of the evaluation to run, such as `1of4`; empty for all.
        `worlds`: sources of user-defined worlds, and files of SLAM presets by name and of robots by `robot NAME`.
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
        self._episodes.path.touch()  # claims the folder for these settings
        self._check_settings()  # another shard may have claimed it meanwhile

    def _read(self) -> None:
        self._rows = {Key.of(row): row for row in self._episodes.read()}
        self._failures = {Key.of(row): row["reason"] for row in self._reasons.read()}
        self._known_worlds = {row["world"]: row for row in self._worlds.read()}
        there = {name for key in self._rows for name in _files_of(key._asdict())}
        for world, own in self._own_worlds.items():
            known = self._known_worlds.get(world, own)
            if world in there and (known["content"] or known["source"]) != (own["content"] or own["source"]):
                was, now = known["source"], own["source"]
                what = f"of an earlier version of {now}" if was == now else f"of {was}, not of {now}"
                is_world = any(key.world == world for key in self._rows)
                rename = "give the world another name, as LABEL=PATH, " if is_world else ""
                raise ValueError(
                    f"{self.folder} holds episodes {'in a world' if is_world else 'with'} {world!r} {what}; "
                    f"{rename}choose another --out, or remove the folder"
                )

    def find(self, key: Key, model: str = "") -> Row | None:
        """Return the results of an episode, if any; raise ValueError if their network weights differ from `model`."""
        row = self._rows.get(key)
        if row and row["model"] != model:
            raise ValueError(
                f"{self.folder} holds episodes of {key.policy} with other weights (has training continued?); "
                "choose another --out, or remove the folder"
            )
        return row

    def failure(self, key: Key) -> str | None:
        """Return the reason why an episode failed; None if the episode finished or was never tried."""
        return None if key in self._rows else self._failures.get(key)

    def add(self, row: Row) -> None:
        for name in _files_of(row):
            own = self._own_worlds.get(name)
            if own and self._known_worlds.get(name) != own:
                self._worlds.append(own)
                self._known_worlds[name] = own
        self._episodes.append(row)
        self._rows[Key.of(row)] = row

    def add_failure(self, key: Key, reason: str) -> None:
        if self._failures.get(key) != reason:
            self._reasons.append(key._asdict() | {"reason": reason})
            self._failures[key] = reason

    def _check_settings(self) -> None:
        path = self.folder / SETTINGS_FILE
        if not path.exists() or not any(self.folder.glob("episodes*.csv")):  # new, or without episodes
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
    def __init__(self, folder: Path, name: str, columns: Readers, shard: str) -> None:
        self._folder, self._name, self._columns = folder, name, columns
        self.path = folder / (f"{name}-{shard}.csv" if shard else f"{name}.csv")

    def read(self) -> Iterator[Row]:
        for path in sorted([*self._folder.glob(f"{self._name}.csv"), *self._folder.glob(f"{self._name}-*.csv")]):
            yield from read_table(path, self._columns)

    def append(self, row: Row) -> None:
        content = read_bytes(self.path) if self.path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        with naming(self.path):
            if whole != content:
                # Incomplete line of a killed process; its episode runs again.
                os.truncate(self.path, len(whole))
        lines = [row[name] for name in self._columns]
        append_file(self.path, csv_text([lines] if whole else [self._columns, lines]))


def read_table(path: Path, columns: Readers) -> Iterator[Row]:
    """Yield the complete rows of a CSV table; raise ValueError if the table is damaged or has other columns."""
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
            raise ValueError(f"{path}, row {number}: damaged: {error}; remove the row to run it again") from error


def _files_of(row: Row) -> tuple[str, ...]:
    """Return the names of the files that an episode may depend on, as in `worlds.csv`."""
    return row["world"], row["slam"], f"robot {row['robot']}"


def _fingerprint(source: str) -> str:
    path = Path(source)
    if not path.is_file():
        return ""
    content, image = read_bytes(path), read_mapping(path).get("image")
    return hashlib.sha256(content + (read_bytes(path.parent.joinpath(image)) if image else b"")).hexdigest()[:12]
