"""Several trainings by one configuration: `sweep`, values by key, and `seeds`; each in a run of its own."""

import contextlib
import itertools
import platform
import re
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.table import Table
from rich.text import Text
from scipy import stats

from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, change, parse_config
from lidarnaut.agents.curves import LEARNED, LEARNED_NAMES, SCORES, draw_sweep, headline_of_rows, read_evaluations
from lidarnaut.agents.learned import POLICY
from lidarnaut.agents.pools import make_pool, stop
from lidarnaut.agents.resume import check_changes
from lidarnaut.agents.run_folder import SWEEP, CheckpointError, count_done, list_checkpoints, write_table
from lidarnaut.agents.trust import resuming
from lidarnaut.envs.command_line import make_console
from lidarnaut.envs.files import naming, own_folder, printable, read_bytes, read_json, write_file
from lidarnaut.envs.processes import interrupts_held
from lidarnaut.envs.progress import Progress

TABLE, PICTURE = "sweep.csv", "sweep.png"
TIME = "processor_time"
"""File of a run: the processor time that its process has taken [s], but for processes that were killed."""
_apart: list[Executor] = []
"""Pools of `_try_apart`."""


@dataclass(frozen=True, slots=True)
class Member:
    """A training of a sweep."""

    values: Mapping[str, Any]
    """What the sweep gives it, by key; without the seed."""
    config: TrainingConfig | EvolutionConfig
    run: Path
    group: str = ""
    """The name of its settings, the first where the sweep has several; its trainings share a picture."""

    @property
    def label(self) -> str:
        """The values, for people."""
        return ", ".join(f"{key.rpartition('.')[2]} {value}" for key, value in self.values.items()) or "all"


def run_sweep(
    data: Mapping[str, Any],
    source: str,
    *,
    resume: Path | None = None,
    ray: str | None = None,
    jobs: int = 1,
    progress: bool = True,
) -> Path:
    """Train all of a sweep, or what is left of it, and write its table and its picture; return the folder.

    It holds a run for each training, `sweep.yaml`, `sweep.csv` and pictures. `data`: a configuration that comes from
    `source`, which messages name, with `sweep` or `seeds` in it; `resume`: folder of a sweep that is to go on; `ray`:
    address of a Ray cluster to train on, whose machines reach the folder under its path; without one, `jobs` trainings
    run side by side on this machine; `progress`: whether to show progress bars, and to print the table.

    Raises:
        ValueError: if a configuration is wrong, or trainings fail; the others go on. It has a line for each failure.
        CheckpointError: if the folder holds trainings of another sweep, or a key changes that must not, see
            `lidarnaut.agents.resume`.
        KeyboardInterrupt: on Ctrl-C; what is trained is kept, and the message names the folder.
    """
    folder = resume or Path("runs") / f"{data.get('experiment')}__sweep__{time.strftime('%Y%m%d-%H%M%S')}"
    folder = folder.absolute() if ray else folder  # for workers in other folders
    members = expand(data, source, folder)
    for run in sorted(path.parent for path in folder.glob("*/config.yaml")):
        if not (found := [member.config for member in members if member.run == run]):
            raise CheckpointError(f"{run} is no longer in the sweep: sweep, exclude and seeds may only add trainings")
        check_changes(found[0], "sweep", run)
    pool: Any = contextlib.nullcontext()
    if ray is not None:
        pool = make_pool(None, ray, [member.config.model_dump() for member in members])
    elif jobs > 1:
        pool = ThreadPoolExecutor(jobs)
    own_folder(folder)
    write_file(folder / SWEEP, yaml.safe_dump(dict(data), sort_keys=False))
    failures: dict[Path, str] = {}
    bar = Progress(total=len(members), unit="training", disable=not progress)
    calls: list[Callable[[], str]] = [partial(try_member, member, progress=progress) for member in members]
    try:
        with bar, pool:
            if isinstance(pool, Executor):
                calls = [pool.submit(try_member if ray else _try_apart, member).result for member in members]
            try:
                for member, finish in zip(members, calls, strict=True):
                    try:
                        failure = finish()
                    except Exception as error:  # of a process that has died, or did not begin
                        failure = _explain(error)
                    failures |= {member.run: failure} if failure else {}
                    bar.update()
            except BaseException:
                for one in (pool, *_apart) if isinstance(pool, Executor) else ():
                    stop(one)
                    one.shutdown(wait=False, cancel_futures=True)
                raise
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in a sweep; {resuming(folder, data)} goes on") from None
    _summarise([member for member in members if member.run not in failures], folder, progress)
    if failures:
        said = "\n".join(f"{run.name}: {failure}" for run, failure in failures.items())
        raise ValueError(
            f"{len(failures)} of {len(members)} trainings failed, {resuming(folder, data)} tries again:\n{said}"
        )
    return folder


def expand(data: Mapping[str, Any], source: str, folder: Path) -> list[Member]:
    """Return the trainings of a sweep, with runs in a folder.

    Classic policies are measured once for each environment: by the first training there.

    Raises:
        ValueError: if `sweep`, `exclude` or `seeds` is not of its form, or a configuration is wrong.
    """
    axes, seeds = data.get("sweep") or {}, data.get("seeds", [data.get("seed", 0)])
    if not isinstance(axes, dict) or not all(isinstance(values, list | dict) and values for values in axes.values()):
        raise ValueError(
            f"{source}: sweep must hold lists of values by keys such as hyperparameters.gamma, or settings by names, "
            f"got {axes!r}"
        )
    if not isinstance(seeds, list) or not seeds:
        raise ValueError(f"{source}: seeds must be a list of whole numbers, got {seeds!r}")
    excluded = _read_excluded(data, axes, source)
    base = {key: value for key, value in data.items() if key not in ("sweep", "seeds", "exclude")}
    members, measured = list[Member](), list[Any]()
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        if any(all(chosen[key] in rule[key] for key in rule) for rule in excluded):
            continue
        settings = base
        for key, value in chosen.items():
            if isinstance(named := axes[key], dict) and not isinstance(named[value], dict):
                raise ValueError(f"{source}: sweep, {key}: {value} must hold settings, got {named[value]!r}")
            settings = _merge(settings, named[value]) if isinstance(named, dict) else change(settings, {key: value})
        for seed in seeds:
            config = parse_config(change(settings, {"seed": seed}), source)
            if isinstance(config, TrainingConfig):
                alone = config.evaluation.model_copy(update={"references": ()})
                episodes = config.environment, config.evaluation.model_copy(update={"every": 1})
                if episodes in measured:
                    config = config.model_copy(update={"evaluation": alone})
                measured.append(episodes)
            name = "_".join(f"{key.rpartition('.')[2]}={value}" for key, value in chosen.items())
            group = next((str(value) for key, value in chosen.items() if isinstance(axes[key], dict)), "")
            members.append(Member(chosen, config, folder / f"{len(members):03d}_{_slug(name)}__{seed}", group))
    return members


def _slug(name: str) -> str:
    """Return a name for a file."""
    return re.sub(r"[^\w.+=-]+", "-", name)[:80]


def _read_excluded(data: Mapping[str, Any], axes: Mapping[str, Any], source: str) -> list[dict[str, list[Any]]]:
    """Return which values are not trained together; ValueError names what is no value of the sweep."""
    rules = list(data.get("exclude") or [])
    for key, values in itertools.chain.from_iterable(rule.items() for rule in rules):
        known = list(axes.get(key, ()))
        if not isinstance(values, list) or any(value not in known for value in values):
            raise ValueError(
                f"{source}: exclude must hold lists of values of the sweep, got {key}: {values}; {key} has {known}"
            )
    return rules


def _merge(settings: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested settings with those of others, which count where both have one."""
    merged = dict(settings)
    for key, value in more.items():
        are_nested = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merge(merged[key], value) if are_nested else value
    return merged


def is_finished(member: Member) -> bool:
    """Tell whether a training has come to its end."""
    config, run = member.config, member.run
    if isinstance(config, EvolutionConfig):
        record = run / POLICY / "policy.json"
        return record.exists() and read_json(record)["generation"] >= config.generations
    return bool(list_checkpoints(run)) and count_done(run) >= config.total_steps


def try_member(member: Member, *, progress: bool = False) -> str:
    """Train one as `train_member`; return its failure in a line, with the file of the traceback, or an empty text."""
    kept = member.run.with_name(f"{member.run.name}.traceback.txt")
    if not (member.run.parent / SWEEP).exists():
        return f"{platform.node()} does not reach {member.run.parent}, which all machines must share"
    kept.unlink(missing_ok=True)
    try:
        train_member(member, progress=progress)
    except (Exception, SystemExit) as error:
        write_file(kept, traceback.format_exc())
        return f"{_explain(error)} (traceback: {kept})"
    return ""


def _try_apart(member: Member) -> str:
    """Train one as `try_member`, in a process of its own: one that dies takes no other with it."""
    with make_pool(1, None) as pool:
        _apart.append(pool)
        with interrupts_held():
            future = pool.submit(try_member, member)
        return future.result()


def _explain(error: BaseException) -> str:
    """Return kind and text of an error in a line."""
    return printable(" ".join(f"{type(error).__name__}: {error}".split())[:1000])


def train_member(member: Member, *, progress: bool = False) -> None:
    """Train one, or go on with it, unless it is finished, and count its time; raises as `training.train`."""
    config, run, begun = member.config, member.run, time.process_time()
    if is_finished(member):
        return
    try:
        if isinstance(config, EvolutionConfig):
            from lidarnaut.agents.frontiers.evolution import evolve

            evolve(config, run=run, resume=run if (run / "config.yaml").exists() else None, progress=progress)
        else:
            from lidarnaut.agents.training import train

            train(config, run=run, resume=run if list_checkpoints(run) else None, progress=progress)
    finally:
        if run.is_dir():
            write_file(run / TIME, f"{processor_time(run) + time.process_time() - begun:.1f}\n")


def processor_time(run: Path) -> float:
    """Return the processor time that a sweep's training has taken so far [s], without worker processes."""
    return float(read_bytes(run / TIME)) if (run / TIME).exists() else 0.0


def _summarise(members: Sequence[Member], folder: Path, shows: bool) -> None:
    """Write a row for each training, and draw the learning curves of those that differ in the seed alone.

    There is a picture for each of the settings with a name: what they measure may differ.
    """
    table: list[dict[str, Any]] = []
    for group, some in itertools.groupby(members, lambda member: member.group):
        curves: dict[str, list[np.ndarray]] = {}
        for member in some:
            rows = read_evaluations(member.run)
            learned, headline = [row for row in rows if row["policy"] in LEARNED_NAMES], headline_of_rows(rows)
            last = {name: value for name, value in learned[-1].items() if name != SCORES}
            table.append({**member.values, "seed": member.config.seed, TIME: processor_time(member.run), **last})
            label = member.label + str(last["policy"]).removeprefix(LEARNED)
            curves.setdefault(label, []).append(np.array([[row["steps"], row[headline]] for row in learned]))
        intervals = {label: interval(runs) for label, runs in curves.items()}
        picture = folder / (f"{_slug(group)}.png" if group else PICTURE)
        with naming(picture):
            draw_sweep(intervals, headline, group or folder.name, picture)
        if shows:
            shown = Table("trainings", "seeds", "steps", f"{headline} at the end", "95 % interval")
            for label, points in intervals.items():
                last_steps, mean, low, high = points[-1]
                bounds = f"[{low:.4g}, {high:.4g}]" if np.isfinite(low) else ""
                shown.add_row(
                    Text(printable(label)), str(len(curves[label])), f"{last_steps:,.0f}", f"{mean:.4g}", bounds
                )
            make_console().print(shown)
    if table:
        write_table(folder / TABLE, table)


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
