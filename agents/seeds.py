"""Sweeps: trainings of one configuration with several random seeds (key `seeds`)."""

import contextlib
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich.table import Table

from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, parse_config
from lidarnaut.agents.curves import (
    SCORES,
    Row,
    curve_of,
    draw_seeds,
    headline_of_rows,
    read_evaluations,
    result_of,
    scores_of,
)
from lidarnaut.agents.learned import POLICY
from lidarnaut.agents.pools import make_pool
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


class Member(NamedTuple):
    """Training of a sweep."""

    config: TrainingConfig | EvolutionConfig
    run: Path


def train_seeds(
    data: Mapping[str, Any],
    source: str,
    *,
    run: Path | None = None,
    jobs: int = 1,
    progress: bool = True,
) -> Path:
    """Train the unfinished runs of a sweep; write `sweep.csv` and `sweep.png`; return the folder.

    `data`: complete configuration with `seeds`. `source`: origin of the configuration, for messages. `run`: new or
    existing folder of the sweep. Other arguments and errors are those of `lidarnaut.train`. Also raises ValueError
    if trainings fail, after all others are done.
    """
    folder = run or Path("runs") / f"{data.get('experiment')}__sweep__{time.strftime('%Y%m%d-%H%M%S')}"
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}")
    if (folder / "config.yaml").exists():
        raise CheckpointError(f"{folder} holds a single run: seeds may not change")
    members, record = expand(data, source, folder), yaml.safe_dump(dict(data), sort_keys=False)
    for begun in sorted(path.parent for path in folder.glob("*/config.yaml")):
        if not (found := [member.config for member in members if member.run == begun]):
            raise CheckpointError(f"{begun} is no longer in the sweep: seeds may only be added")
        check_changes(found[0], "sweep", begun)
    if (folder / SWEEP).exists():
        check_changes(yaml.safe_load(record), "sweep", folder, read_mapping(folder / SWEEP))
    unfinished = [member for member in members if not is_finished(member)]
    failures, again = dict[Path, str](), resuming(folder, data)
    held: Any = contextlib.nullcontext() if jobs == 1 else make_pool(jobs)
    try:
        with held as pool, Progress(total=len(unfinished), unit="training", disable=not progress) as bar:
            own_folder(folder)
            write_file(folder / SWEEP, record)
            outcomes = (_train(member, progress=progress) for member in unfinished)
            if pool is not None:
                with interrupts_held():
                    futures = [pool.submit(_train, member) for member in unfinished]
                outcomes = (_explain(error) if (error := one.exception()) else one.result() for one in futures)
            for member, failure in zip(unfinished, outcomes, strict=True):
                failures |= {member.run: failure} if failure else {}
                bar.update()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in a sweep; resume with {again}") from None
    if done := [member for member in members if member.run not in failures]:
        _summarise(done, folder, progress)
    if failures:
        said = "\n".join(f"{run.name}: {failure}" for run, failure in failures.items())
        raise ValueError(f"{len(failures)} of {len(members)} trainings failed; retry with {again}:\n{said}")
    return folder


def expand(data: Mapping[str, Any], source: str, folder: Path) -> list[Member]:
    """Return the trainings of a sweep, by its complete configuration; ValueError if invalid.

    All share the evaluation episodes: only the first evaluates the reference policies.
    """
    seeds, members = data["seeds"], list[Member]()
    if not isinstance(seeds, list) or not seeds:
        raise ValueError(f"{source}: seeds must be a list of whole numbers, got {seeds!r}")
    base = {key: value for key, value in data.items() if key != "seeds"}
    for seed in seeds:
        config: Any = parse_config(base | {"seed": seed}, source)
        if isinstance(config, TrainingConfig) and members:
            evaluation = config.evaluation.model_copy(update={"references": ()})
            config = config.model_copy(update={"evaluation": evaluation})
        members.append(Member(config, folder / f"seed_{config.seed}"))
    if len({member.run for member in members}) < len(members):
        raise ValueError(f"{source}: seeds must differ, got {seeds}")
    return members


def read_members(folder: Path) -> list[Member]:
    """Return the finished trainings of the sweep in a folder; none without one."""
    members = expand(read_mapping(file), str(file), folder) if (file := folder / SWEEP).exists() else []
    return [member for member in members if is_finished(member)]


def is_finished(member: Member) -> bool:
    """Return True if a training run is finished, and its result measured."""
    config, run = member.config, member.run
    if isinstance(config, EvolutionConfig):
        generation = read_json(record).get("generation") if (record := run / POLICY / "policy.json").exists() else None
        return isinstance(generation, int) and generation >= config.generations
    return bool(list_checkpoints(run)) and count_done(run) >= config.total_steps and is_measured(run)


def _train(member: Member, *, progress: bool = False) -> str:
    """Train or resume a run, and record its processor time; return an empty text, or the error message in one line."""
    config, run, begun = member.config, member.run, time.process_time()
    kept = run.with_name(f"{run.name}.traceback.txt")
    kept.unlink(missing_ok=True)
    try:
        if isinstance(config, EvolutionConfig):
            from lidarnaut.agents.frontiers.evolution import evolve

            evolve(config, run=run, resume=run if (run / "config.yaml").exists() else None, progress=progress)
        else:
            from lidarnaut.agents.learning import run_training

            run_training(config, run=run, resume=run if list_checkpoints(run) else None, progress=progress)
    except (Exception, SystemExit) as error:
        write_file(kept, traceback.format_exc())
        return f"{_explain(error)} (traceback: {kept})"
    finally:
        if run.is_dir():
            write_file(run / TIME, f"{processor_time(run) + time.process_time() - begun:.1f}\n")
    return ""


def _explain(error: BaseException) -> str:
    return printable(" ".join(f"{type(error).__name__}: {error}".split())[:1000])


def processor_time(run: Path) -> float:
    """Return the processor time of a run [s], without worker processes."""
    return float(read_bytes(run / TIME)) if (run / TIME).exists() else 0.0


def _summarise(members: Sequence[Member], folder: Path, shows: bool) -> None:
    table, curves = list[dict[str, Any]](), list[list[Row]]()
    for member in members:
        rows = read_evaluations(member.run)
        last = {name: value for name, value in (result_of(rows) or curve_of(rows)[-1]).items() if name != SCORES}
        table.append({"seed": member.config.seed, TIME: processor_time(member.run), **last})
        curves.append(curve_of(rows))
    write_table(folder / TABLE, table)
    headline, points = headline_of_rows(curves[0]), list[tuple[float, ...]]()
    for same in zip(*curves):
        scores = np.array([scores_of(row) for row in same])
        points.append((float(same[0]["steps"]), *score(scores, is_widened=True)[:3]))
    with naming(folder / PICTURE):
        draw_seeds(np.array(points), headline, folder.name, folder / PICTURE)
    if shows:
        steps, mean, low, high = points[-1]
        shown = Table("seeds", "steps", f"{headline} at the end", "95 % interval")
        shown.add_row(str(len(curves)), f"{steps:,.0f}", f"{mean:.4g}", f"[{low:.4g}, {high:.4g}]")
        make_console().print(shown)
