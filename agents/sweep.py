"""Several trainings by one configuration: `sweep`, lists of values by key, and `seeds`; each in a run of its own."""

import contextlib
import itertools
import json
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.table import Table
from scipy import stats

from agents.config import EvolutionConfig, TrainingConfig, change, parse_config
from agents.curves import LEARNED, draw_sweep, headline_of_rows, read_evaluations
from agents.learned import POLICY
from agents.pools import make_pool
from agents.run_folder import RECORD_FILE, SWEEP, CheckpointError, list_checkpoints, write_table
from envs.command_line import make_console
from envs.files import LockedError, naming, write_file
from envs.progress import Progress

TABLE, PICTURE = "sweep.csv", "sweep.png"


@dataclass(frozen=True, slots=True)
class Member:
    """A training of a sweep."""

    values: Mapping[str, Any]
    """What the sweep gives it, by key; without the seed."""
    config: TrainingConfig | EvolutionConfig
    run: Path

    @property
    def label(self) -> str:
        """The values, for people."""
        return ", ".join(f"{key.rpartition('.')[2]} {value}" for key, value in self.values.items()) or "all"


def run_sweep(
    data: Mapping[str, Any], source: str, *, resume: Path | None = None, ray: str | None = None, progress: bool = True
) -> Path:
    """Train all of a sweep, or what is left of it, and write its table and its picture; return the folder.

    It holds a run for each training, `sweep.yaml`, `sweep.csv` and `sweep.png`. `data`: a configuration that comes from
    `source`, which messages name, with `sweep` or `seeds` in it; `resume`: folder of a sweep that is to go on; `ray`:
    address of a Ray cluster to train on, whose machines reach the folder under its path, None trains one after the
    other; `progress`: whether to show progress bars, and to print the table.

    Raises:
        ValueError: if a configuration is wrong, or trainings fail; the others go on.
        KeyboardInterrupt: on Ctrl-C; what is trained is kept, and the message names the folder.
    """
    folder = resume or Path("runs") / f"{data.get('experiment')}__sweep__{time.strftime('%Y%m%d-%H%M%S')}"
    members = expand(data, source, folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / SWEEP, yaml.safe_dump(dict(data), sort_keys=False))
    failures: dict[Path, Exception] = {}
    bar = Progress(total=len(members), unit="training", disable=not progress)
    calls: list[Callable[[], Any]] = [partial(train_member, member, progress=progress) for member in members]
    try:
        with bar, make_pool(None, ray) if ray else contextlib.nullcontext() as pool:
            if pool is not None:
                calls = [pool.submit(train_member, member).result for member in members]
            for member, finish in zip(members, calls, strict=True):
                try:
                    finish()
                except (ValueError, CheckpointError, LockedError, OSError) as error:
                    failures[member.run] = error
                bar.update()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in a sweep; --resume {folder} goes on") from None
    _summarise([member for member in members if member.run not in failures], folder, progress)
    if failures:
        said = "\n".join(f"{run.name}: {error}" for run, error in failures.items())
        raise ValueError(f"{len(failures)} of {len(members)} trainings failed, --resume {folder} tries again:\n{said}")
    return folder


def expand(data: Mapping[str, Any], source: str, folder: Path) -> list[Member]:
    """Return the trainings of a sweep, with runs in a folder.

    Raises:
        ValueError: if `sweep` or `seeds` is no list of values, or a configuration is wrong.
    """
    keys, seeds = data.get("sweep") or {}, data.get("seeds", [data.get("seed", 0)])
    if not isinstance(keys, dict) or not all(isinstance(values, list) and values for values in keys.values()):
        raise ValueError(
            f"{source}: sweep must hold lists of values by keys such as hyperparameters.gamma, got {keys!r}"
        )
    if not isinstance(seeds, list) or not seeds:
        raise ValueError(f"{source}: seeds must be a list of whole numbers, got {seeds!r}")
    base = {key: value for key, value in data.items() if key not in ("sweep", "seeds")}
    members: list[Member] = []
    for values in itertools.product(*keys.values()):
        chosen = dict(zip(keys, values, strict=True))
        for seed in seeds:
            config = parse_config(change(base, {**chosen, "seed": seed}), source)
            name = "_".join(f"{key.rpartition('.')[2]}={value}" for key, value in chosen.items())
            name = re.sub(r"[^\w.+=-]+", "-", name)[:80]
            members.append(Member(chosen, config, folder / f"{len(members):03d}_{name}__{seed}"))
    return members


def train_member(member: Member, *, progress: bool = False) -> None:
    """Train one, or go on with it, unless it is finished; raises as `agents.training.train`."""
    config, run = member.config, member.run
    if isinstance(config, EvolutionConfig):
        from agents.frontiers.evolution import evolve

        record = run / POLICY / "policy.json"
        if not record.exists() or json.loads(record.read_bytes())["generation"] < config.generations:
            is_begun = (run / "config.yaml").exists()
            evolve(config, run=run, resume=run if is_begun else None, progress=progress)
        return
    from agents.training import train

    saved = list_checkpoints(run)
    if not saved or json.loads((saved[-1] / RECORD_FILE).read_bytes())["steps"] < config.total_steps:
        train(config, run=run, resume=run if saved else None, progress=progress)


def _summarise(members: Sequence[Member], folder: Path, shows: bool) -> None:
    """Write a row for each training, and draw the learning curves of those that differ in the seed alone."""
    if not members:
        return
    curves: dict[str, list[np.ndarray]] = {}
    table: list[dict[str, Any]] = []
    for member in members:
        rows = read_evaluations(member.run)
        learned, headline = [row for row in rows if row["policy"] == LEARNED], headline_of_rows(rows)
        table.append({**member.values, "seed": member.config.seed, **learned[-1]})
        curves.setdefault(member.label, []).append(np.array([[row["steps"], row[headline]] for row in learned]))
    write_table(folder / TABLE, table)
    intervals = {label: interval(runs) for label, runs in curves.items()}
    with naming(folder / PICTURE):
        draw_sweep(intervals, headline, folder.name, folder / PICTURE)
    if shows:
        shown = Table("trainings", "seeds", "steps", f"{headline} at the end", "95 % interval")
        for label, points in intervals.items():
            last, mean, low, high = points[-1]
            bounds = f"[{low:.4g}, {high:.4g}]" if np.isfinite(low) else ""
            shown.add_row(label, str(len(curves[label])), f"{last:,.0f}", f"{mean:.4g}", bounds)
        make_console().print(shown)


def interval(runs: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean of learning curves over seeds with its 95 % interval, by Student's t: shape (n, 4).

    Runs are steps and the measure, shape (n, 2) each, of which the shortest counts. Columns are steps, mean, and the
    bounds, which are NaN for a single run.
    """
    length = min(len(run) for run in runs)
    values = np.array([run[:length, 1] for run in runs])
    mean, margin = values.mean(axis=0), np.full(length, np.nan)
    if len(runs) > 1:
        margin = stats.t.ppf(0.975, len(runs) - 1) * values.std(axis=0, ddof=1) / np.sqrt(len(runs))
    return np.stack([runs[0][:length, 0], mean, mean - margin, mean + margin], axis=1)
