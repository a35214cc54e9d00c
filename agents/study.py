"""Studies: a training for each combination of settings (key `sweep`) and random seed (key `seeds`)."""

import contextlib
import itertools
import logging
import multiprocessing
import platform
import re
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.table import Table
from rich.text import Text

from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, change, merge, parse_config
from lidarnaut.agents.curves import (
    LEARNED,
    SCORES,
    Row,
    curve_of,
    draw_study,
    headline_of_rows,
    read_evaluations,
    result_of,
    scores_of,
)
from lidarnaut.agents.learned import POLICY
from lidarnaut.agents.pools import make_pool
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.agents.resume import check_changes
from lidarnaut.agents.run_folder import SWEEP, CheckpointError, count_done, is_measured, list_checkpoints, write_table
from lidarnaut.agents.statistics import score
from lidarnaut.agents.trust import resuming
from lidarnaut.envs.command_line import make_console
from lidarnaut.envs.files import naming, own_folder, printable, read_bytes, read_json, read_mapping, write_file
from lidarnaut.envs.processes import interrupts_held
from lidarnaut.envs.progress import Progress

TABLE, PICTURE = "sweep.csv", "sweep.png"
TIME = "processor_time"
LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Member:
    """Training of a study."""

    values: Mapping[str, Any]
    """Values that the study sets in this run, by configuration key, without the seed."""
    config: TrainingConfig | EvolutionConfig
    run: Path
    group: str = ""
    """Name of this run's settings, if the study compares named settings. Learning curves of equal name share a plot."""
    recipe: str = ""
    """Description of the recipe under the configuration; empty without one."""

    @property
    def label(self) -> str:
        return ", ".join(f"{key.rpartition('.')[2]} {value}" for key, value in self.values.items()) or "all"


def run_study(
    data: Mapping[str, Any],
    source: str,
    *,
    resume: Path | None = None,
    ray: str | None = None,
    jobs: int = 1,
    progress: bool = True,
) -> Path:
    """Train the unfinished runs of a study; write `sweep.csv` and plots; return the folder.

    `data`: configuration with `sweep` or `seeds`. `source`: origin of the configuration, for messages. Other arguments
    and errors are those of `lidarnaut.train`; machines of a Ray cluster share the folder. Also raises ValueError if
    trainings fail, after all others are done.
    """
    folder = resume or Path("runs") / f"{data.get('experiment')}__sweep__{time.strftime('%Y%m%d-%H%M%S')}"
    folder = folder.absolute() if ray else folder
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    if (folder / "config.yaml").exists():
        raise CheckpointError(f"{folder} holds a single run: sweep and seeds may not change")
    members, record = expand(data, source, folder), yaml.safe_dump(dict(data), sort_keys=False)
    for text in dict.fromkeys(member.recipe for member in members if member.recipe):
        LOGGER.info("%s", text)
    for run in sorted(path.parent for path in folder.glob("*/config.yaml")):
        if not (found := [member.config for member in members if member.run == run]):
            raise CheckpointError(f"{run} is no longer in the sweep: sweep, exclude and seeds may only add trainings")
        check_changes(found[0], "sweep", run)
    if (folder / SWEEP).exists():
        check_changes(yaml.safe_load(record), "sweep", folder, read_mapping(folder / SWEEP))
    held: Any = _processes(jobs) if jobs > 1 else contextlib.nullcontext()
    if ray is not None:
        held = make_pool(None, ray, [member.config.model_dump() for member in members])
    failures, again = dict[Path, str](), resuming(folder, data)
    try:
        with held as pool, Progress(total=len(members), unit="training", disable=not progress) as bar:
            own_folder(folder)
            write_file(folder / SWEEP, record)
            outcomes = (try_member(member, progress=progress) for member in members)
            if pool is not None:
                futures = [pool.submit(try_member if ray else _try_apart, member) for member in members]
                outcomes = (_explain(error) if (error := one.exception()) else one.result() for one in futures)
            for member, failure in zip(members, outcomes, strict=True):
                failures |= {member.run: failure} if failure else {}
                bar.update()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in a sweep; resume with {again}") from None
    _summarise([member for member in members if member.run not in failures], folder, progress)
    if failures:
        said = "\n".join(f"{run.name}: {failure}" for run, failure in failures.items())
        raise ValueError(f"{len(failures)} of {len(members)} trainings failed; retry with {again}:\n{said}")
    return folder


def expand(data: Mapping[str, Any], source: str, folder: Path) -> list[Member]:
    """Return the runs of a study: all combinations of settings and seeds; ValueError if invalid.

    Among runs with the same evaluation episodes, only the first evaluates the reference policies.
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
    left = {path.parent for path in folder.glob("*/config.yaml")}
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        if any(all(chosen[key] in rule[key] for key in rule) for rule in excluded):
            continue
        settings = base
        for key, value in chosen.items():
            if isinstance(named := axes[key], dict) and not isinstance(named[value], dict):
                raise ValueError(f"{source}: sweep, {key}: {value} must hold settings, got {named[value]!r}")
            settings = merge(settings, named[value]) if isinstance(named, dict) else change(settings, {key: value})
        for seed in seeds:
            merged, text = with_recipe(change(settings, {"seed": seed}))
            config = parse_config(merged, source)
            if isinstance(config, TrainingConfig):
                alone = config.evaluation.model_copy(update={"references": ()})
                episodes = config.environment, config.evaluation.model_copy(update={"every": 1})
                if episodes in measured:
                    config = config.model_copy(update={"evaluation": alone})
                measured.append(episodes)
            name = "_".join(f"{key.rpartition('.')[2]}={value}" for key, value in chosen.items())
            group = next((str(value) for key, value in chosen.items() if isinstance(axes[key], dict)), "")
            numbered = folder / f"{len(members):03d}_{_slug(name)}__{seed}"
            alike = [run for run in left if run.name.partition("_")[2] == numbered.name.partition("_")[2]]
            run = numbered if numbered in alike or not alike else alike[0]
            left -= {run}
            members.append(Member(chosen, config, run, group, text))
    return members


def _slug(name: str) -> str:
    return re.sub(r"[^\w.+=-]+", "-", name)[:80]


def _read_excluded(data: Mapping[str, Any], axes: Mapping[str, Any], source: str) -> list[dict[str, list[Any]]]:
    rules = list(data.get("exclude") or [])
    for key, values in itertools.chain.from_iterable(rule.items() for rule in rules):
        own = list(axes.get(key, ()))
        if not isinstance(values, list) or any(value not in own for value in values):
            raise ValueError(f"{source}: exclude must hold lists of sweep values, got {key}: {values}; {key} has {own}")
    return rules


def is_finished(member: Member) -> bool:
    """Return True if a training run is finished, and its result measured."""
    config, run = member.config, member.run
    if isinstance(config, EvolutionConfig):
        record = run / POLICY / "policy.json"
        return record.exists() and read_json(record)["generation"] >= config.generations
    return bool(list_checkpoints(run)) and count_done(run) >= config.total_steps and is_measured(run)


def try_member(member: Member, *, progress: bool = False) -> str:
    """Train a run; return an empty text, or the error message in one line."""
    kept = member.run.with_name(f"{member.run.name}.traceback.txt")
    if not (member.run.parent / SWEEP).exists():
        return f"{platform.node()} cannot access {member.run.parent}, which all machines must share"
    kept.unlink(missing_ok=True)
    try:
        train_member(member, progress=progress)
    except (Exception, SystemExit) as error:
        write_file(kept, traceback.format_exc())
        return f"{_explain(error)} (traceback: {kept})"
    return ""


@contextlib.contextmanager
def _processes(jobs: int) -> Iterator[Executor]:
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _try_apart(member: Member) -> str:
    if is_finished(member):
        return ""
    with make_pool(1, None) as pool, interrupts_held():
        return pool.submit(try_member, member).result()


def _explain(error: BaseException) -> str:
    return printable(" ".join(f"{type(error).__name__}: {error}".split())[:1000])


def train_member(member: Member, *, progress: bool = False) -> None:
    """Train or resume an unfinished run, and record its processor time."""
    config, run, begun = member.config, member.run, time.process_time()
    if is_finished(member):
        return
    try:
        if isinstance(config, EvolutionConfig):
            from lidarnaut.agents.frontiers.evolution import evolve

            evolve(config, run=run, resume=run if (run / "config.yaml").exists() else None, progress=progress)
        else:
            from lidarnaut.agents.learning import run_training

            run_training(config, run=run, resume=run if list_checkpoints(run) else None, progress=progress)
    finally:
        if run.is_dir():
            write_file(run / TIME, f"{processor_time(run) + time.process_time() - begun:.1f}\n")


def processor_time(run: Path) -> float:
    """Return the processor time of a run [s], without worker processes."""
    return float(read_bytes(run / TIME)) if (run / TIME).exists() else 0.0


def _summarise(members: Sequence[Member], folder: Path, shows: bool) -> None:
    table: list[dict[str, Any]] = []
    for group, some in itertools.groupby(members, lambda member: member.group):
        curves: dict[str, list[list[Row]]] = {}
        for member in some:
            rows = read_evaluations(member.run)
            headline, result = headline_of_rows(rows), result_of(rows) or curve_of(rows)[-1]
            last = {name: value for name, value in result.items() if name != SCORES}
            table.append({**member.values, "seed": member.config.seed, TIME: processor_time(member.run), **last})
            label = member.label + str(last["policy"]).removeprefix(LEARNED)
            curves.setdefault(label, []).append(curve_of(rows))
        intervals = {label: np.array(list(map(_point, zip(*runs)))) for label, runs in curves.items()}
        picture = folder / (f"{_slug(group)}.png" if group else PICTURE)
        with naming(picture):
            draw_study(intervals, headline, group or folder.name, picture)
        if shows:
            shown = Table("trainings", "seeds", "steps", f"{headline} at the end", "95 % interval")
            for label, points in intervals.items():
                last_steps, mean, low, high = points[-1]
                bounds = f"{mean:.4g}", f"[{low:.4g}, {high:.4g}]"
                shown.add_row(Text(printable(label)), str(len(curves[label])), f"{last_steps:,.0f}", *bounds)
            make_console().print(shown)
    if table:
        write_table(folder / TABLE, table)


def _point(rows: Sequence[Row]) -> tuple[float, ...]:
    """Return steps, mean, and 95 % interval over seeds and episodes of one evaluation of several runs."""
    scores = np.array([scores_of(row) for row in rows])
    return (float(rows[0]["steps"]), *score(scores, is_widened=True)[:3])
