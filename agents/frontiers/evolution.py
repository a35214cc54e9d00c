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
import shutil
from pathlib import Path

import numpy as np
from cmaes import CMA
from torch.utils.tensorboard import SummaryWriter

from agents.config import EvolutionConfig
from agents.learned import POLICY
from agents.pools import Pool, make_pool
from agents.run_folder import GENERATIONS, CheckpointError, open_run, write_validations
from envs.files import write_file
from envs.progress import Progress

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
    config: EvolutionConfig,
    *,
    run: Path | None = None,
    resume: Path | None = None,
    progress: bool = True,
    ray: str | None = None,
) -> Path:
    """Train a score, and return the folder of the run; arguments as for `agents.training.train`.

    Individuals explore in processes of this machine, or on the Ray cluster whose address is `ray`.

    A run goes on by replaying what its individuals reached: CMA-ES draws them again from the seed.

    Raises:
        CheckpointError: if the files of a run that is to go on do not fit together.
        ValueError: if a new run folder holds a run already.
        envs.files.LockedError: if another process is at the run.
        KeyboardInterrupt: on Ctrl-C; whole generations are kept, and the message names the run.
    """
    with open_run(config, run, resume) as run, make_pool(config.num_workers, ray) as pool:
        evolution = _Evolution(config, run, pool)
        bar = Progress(total=config.generations, initial=len(evolution.values), disable=not progress, unit="generation")
        try:
            with bar, evolution.log:
                evolution.prepare()
                for generation in range(config.generations):
                    if generation % config.validate_every == 0:
                        bar.set_postfix(time_over_rule=f"{evolution.validate(generation):.3f}")
                    bar.update(evolution.advance(generation))
                bar.set_postfix(time_over_rule=f"{evolution.validate(config.generations):.3f}")
        except KeyboardInterrupt:
            pool.stop()
            done = f"after generation {len(evolution.values)}"
            raise KeyboardInterrupt(f"{done}; --resume {run} goes on") from None
        evolution.save()
    return run


class _Evolution:
    """A run: the search by CMA-ES, and the validations of its means."""

    def __init__(self, config: EvolutionConfig, run: Path, pool: Pool) -> None:
        """Read what a run folder holds; raises `CheckpointError` if its files do not fit together."""
        self._config, self._run, self._pool = config, run, pool
        self.values = _read(run / GENERATIONS, config.population)
        """What the individuals of each generation reached, each shape (population,), float64."""
        self._means: list[np.ndarray] = []
        self._validated = _read(run / VALIDATIONS, 2 + NUM_FEATURES)
        seed, population = config.seed, config.population
        self._strategy = CMA(np.zeros(NUM_FEATURES), config.sigma, seed=seed, population_size=population)
        self._tasks = _tasks(config, VALIDATION_SEED, config.validation_tasks)
        self.log = SummaryWriter(str(run / "tensorboard"), purge_step=len(self.values))

    def prepare(self) -> None:
        """Measure the spread of the features, and, unless that is done, the rule `nearest` on the validation tasks."""
        config, path = self._config, self._run / REFERENCE
        variances = list(self._pool.map(feature_variances, _tasks(config, SCALING_SEED, config.tasks)))
        self._spread = np.sqrt(np.mean(variances, axis=0)).clip(LEAST_SPREAD)
        rows = _read(path, config.validation_tasks)
        if not rows:
            rows = [_ratios(self._pool, self._tasks, [NEAREST])[:, 0]]
            _write(path, rows)
        self._nearest = rows[0]

    def validate(self, generation: int) -> float:
        """Validate the policy after so many generations, unless that is done; return its time over the rule's."""
        if not any(row[0] == generation for row in self._validated):
            policy = self._policy(generation)
            jobs = [self._pool.submit(validate, task, policy, PRIOR) for task in self._tasks]
            ratios, explored = np.array([job.result() for job in jobs]).T
            self._validated.append(np.array([generation, ratios.mean(), *policy]))
            _write(self._run / VALIDATIONS, self._validated)
            _log_validation(self.log, generation, ratios, explored, self._nearest)
        rows = sorted((int(row[0]), row[1]) for row in self._validated)
        write_validations(self._run, rows, self._nearest.mean())
        return float(np.exp(self._validated[-1][1]))

    def advance(self, generation: int) -> int:
        """Tell the strategy what the individuals of a generation reach; return 1 if they had to explore, else 0."""
        individuals = [self._strategy.ask() for _ in range(self._config.population)]
        is_new = generation == len(self.values)
        if is_new:
            self.values.append(self._explore(individuals, generation))
            _write(self._run / GENERATIONS, self.values)
            self.log.add_scalar("evolution/time_over_rule", np.exp(self.values[-1].mean()), generation)
        self._strategy.tell(list(zip(individuals, self.values[generation].tolist(), strict=True)))
        self._means.append(self._strategy.mean.copy())
        return int(is_new)

    def save(self) -> None:
        """Write the policy of the last generation."""
        config = self._config
        last = next(row for row in self._validated if row[0] == config.generations)
        record = {"generation": config.generations, "time_over_rule": float(np.exp(last[1])), "seed": config.seed}
        shutil.rmtree(self._run / POLICY, ignore_errors=True)  # of a run that was finished, and goes on
        FrontierScore(last[2:]).save(self._run / POLICY, record)

    def _policy(self, generation: int) -> np.ndarray:
        """Return the average of the means of the second half of the generations as weights, shape (NUM_FEATURES,)."""
        means = self._means[generation // 2 :]
        return PRIOR + np.mean(means, axis=0) / self._spread if means else PRIOR

    def _explore(self, individuals: list[np.ndarray], generation: int) -> np.ndarray:
        """Return what individuals reach in the tasks of a generation: shape (population,), float64."""
        tasks = _tasks(self._config, GENERATION_SEED, self._config.tasks, generation)
        weights = [PRIOR + individual / self._spread for individual in individuals]
        return _ratios(self._pool, tasks, weights).mean(axis=0)


def _tasks(config: EvolutionConfig, stream: int, count: int, step: int = 0) -> list[Task]:
    """Draw tasks that depend on the seed, the numbers given and their index alone."""
    seeds = ([config.seed, stream, step, i] for i in range(count))
    return [draw_task(np.random.default_rng(seed), config.families) for seed in seeds]


def _ratios(pool: Pool, tasks: list[Task], weights: list[np.ndarray]) -> np.ndarray:
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
