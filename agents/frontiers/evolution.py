"""Evolution of a score by CMA-ES (Hansen, "The CMA evolution strategy: a tutorial", 2016).

Every generation draws tasks, and every individual explores all of them: common worlds, starts and noise take most of
the chance out of the comparison. Weights are counted in units of 1 over the spread of their feature among the best
candidates of a decision, so that a step in any direction changes about as many decisions. What is minimised is the mean
logarithm of the time over that of the rule that evolution starts from. The policy is the average of the distribution's
means over the second half of the generations (Polyak and Juditsky, "Acceleration of stochastic approximation by
averaging", 1992): single means differ by less than validation can tell. Validation, on tasks of its own that are drawn
once, reports and selects nothing.
"""

import csv
import io
import multiprocessing
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from cmaes import CMA
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from agents.config import EvolutionConfig
from agents.learned import POLICY
from agents.run_folder import GENERATIONS, CheckpointError, open_run, write_validations
from envs.files import write_file
from envs.processes import start_worker

from .features import NEAREST, NUM_FEATURES, PRIOR
from .rollout import compare, feature_variances, validate
from .score import FrontierScore
from .tasks import TARGET, Task, draw_task

VALIDATIONS = "validations.csv"
"""File of a run beside `GENERATIONS`: the policies that were validated."""
REFERENCE = "nearest.csv"
"""File of a run: the logarithms of the times of the rule `nearest` over the rule's, one per validation task."""
GENERATION_SEED, VALIDATION_SEED, SCALING_SEED = 0, 1, 2
"""Streams of random numbers."""
LEAST_SPREAD = 0.02
"""Spread of features that hardly ever differ."""


def evolve(
    config: EvolutionConfig, *, run: Path | None = None, resume: Path | None = None, progress: bool = True
) -> Path:
    """Train a score, and return the folder of the run; arguments as for `agents.training.train`.

    A run goes on by replaying what its individuals reached: CMA-ES draws them again from the seed.

    Raises:
        CheckpointError: if the files of a run that is to go on do not fit together.
        ValueError: if the run folder is in use.
    """
    run = open_run(config, run, resume)
    values = _read(run / GENERATIONS, config.population)
    means: list[np.ndarray] = []
    validated = _read(run / VALIDATIONS, 2 + NUM_FEATURES)
    strategy = CMA(np.zeros(NUM_FEATURES), config.sigma, seed=config.seed, population_size=config.population)
    tasks = _tasks(config, VALIDATION_SEED, config.validation_tasks)
    log = SummaryWriter(str(run / "tensorboard"), purge_step=len(values))
    bar = tqdm(total=config.generations, initial=len(values), disable=not progress, unit="generation")
    with _pool(config.num_workers) as pool, bar, log:
        variances = list(pool.map(feature_variances, _tasks(config, SCALING_SEED, config.tasks)))
        spread = np.sqrt(np.mean(variances, axis=0)).clip(LEAST_SPREAD)
        if not (nearest := _read(run / REFERENCE, config.validation_tasks)):
            nearest = [_ratios(pool, tasks, [NEAREST])[:, 0]]
            _write(run / REFERENCE, nearest)
        for generation in range(config.generations + 1):
            if generation % config.validate_every == 0 or generation == config.generations:
                if not any(row[0] == generation for row in validated):
                    policy = PRIOR + np.mean(means[generation // 2 :], axis=0) / spread if means else PRIOR
                    jobs = [pool.submit(validate, task, policy, PRIOR) for task in tasks]
                    ratios, explored = np.array([job.result() for job in jobs]).T
                    validated.append(np.array([generation, ratios.mean(), *policy]))
                    _write(run / VALIDATIONS, validated)
                    _log_validation(log, generation, ratios, explored, nearest[0])
                write_validations(run, sorted((int(row[0]), row[1]) for row in validated), nearest[0].mean())
                bar.set_postfix(time_over_rule=f"{np.exp(validated[-1][1]):.3f}")
            if generation == config.generations:
                break
            individuals = [strategy.ask() for _ in range(config.population)]
            if generation == len(values):
                drawn = _tasks(config, GENERATION_SEED, config.tasks, generation)
                ratios = _ratios(pool, drawn, [PRIOR + individual / spread for individual in individuals])
                values.append(ratios.mean(axis=0))
                _write(run / GENERATIONS, values)
                log.add_scalar("evolution/time_over_rule", np.exp(values[-1].mean()), generation)
                bar.update()
            strategy.tell(list(zip(individuals, values[generation].tolist(), strict=True)))
            means.append(strategy.mean.copy())
    last = next(row for row in validated if row[0] == config.generations)
    record = {"generation": config.generations, "time_over_rule": float(np.exp(last[1])), "seed": config.seed}
    shutil.rmtree(run / POLICY, ignore_errors=True)  # of a run that was finished, and goes on
    FrontierScore(last[2:]).save(run / POLICY, record)
    return run


def _tasks(config: EvolutionConfig, stream: int, count: int, step: int = 0) -> list[Task]:
    """Draw tasks that depend on the seed, the numbers given and their index alone."""
    seeds = ([config.seed, stream, step, i] for i in range(count))
    return [draw_task(np.random.default_rng(seed), config.families) for seed in seeds]


def _pool(num_workers: int | None) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(num_workers, multiprocessing.get_context("spawn"), start_worker)


def _ratios(pool: ProcessPoolExecutor, tasks: list[Task], weights: list[np.ndarray]) -> np.ndarray:
    """Return the logarithms of times over the rule's: shape (tasks, individuals), float64."""
    jobs = [pool.submit(compare, task, weights, PRIOR) for task in tasks]
    return np.array([job.result() for job in jobs])


def _log_validation(
    log: SummaryWriter, generation: int, ratios: np.ndarray, explored: np.ndarray, nearest: np.ndarray
) -> None:
    """Log a validation by its tasks: logarithms of times over the rule's, of the score and of `nearest`; fractions."""
    values = {
        "time_over_rule": np.exp(ratios.mean()),
        "time_over_nearest": np.exp((ratios - nearest).mean()),
        "explored_fraction": explored.mean(),
        "reached": (explored >= TARGET).mean(),
    }
    for name, value in values.items():
        log.add_scalar(f"validation/{name}", value, generation)


def _read(path: Path, width: int) -> list[np.ndarray]:
    """Read rows of numbers; none if there is no file."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        try:
            rows = [np.array(row, dtype=np.float64) for row in csv.reader(file)]
        except ValueError as error:
            raise CheckpointError(f"{path} does not hold numbers: {error}") from error
    if any(row.shape != (width,) for row in rows):
        raise CheckpointError(f"{path} does not hold rows of {width} numbers")
    return rows


def _write(path: Path, rows: list[np.ndarray]) -> None:
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([repr(float(value)) for value in row] for row in rows)
    write_file(path, table.getvalue())
