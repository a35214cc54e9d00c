"""Optimization of a linear frontier score by CMA-ES (Hansen 2016, arXiv:1604.00772).

The objective is the mean over episodes of log(exploration time / time of the rule `gain_over_cost`). All individuals of
a generation explore the same tasks. The search space is scaled by the standard deviation of each feature. The policy
averages the distribution means over the second half of the generations (Polyak and Juditsky 1992).
"""

import contextlib
import io
import shutil
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from cmaes import CMA
from torch.utils.tensorboard import SummaryWriter

from lidarnaut.agents.config import EvolutionConfig
from lidarnaut.agents.curves import LEARNED, SCORES, Row, read_evaluations
from lidarnaut.agents.learned import POLICY
from lidarnaut.agents.pools import make_pool
from lidarnaut.agents.resume import begin
from lidarnaut.agents.run_folder import GENERATIONS, CheckpointError, write_evaluations
from lidarnaut.envs.files import read_bytes, write_file
from lidarnaut.envs.progress import Progress

from .features import NEAREST, NUM_FEATURES, PRIOR
from .rollout import compare, feature_variances
from .score import FrontierScore
from .tasks import TARGET, ExplorationTask, draw_task

GENERATION_SEED, VALIDATION_SEED, SCALING_SEED = 0, 1, 2
LEAST_SPREAD = 0.02
"""Lower bound of a feature's standard deviation, which scales the search space of CMA-ES."""


def evolve(
    config: EvolutionConfig,
    *,
    run: Path | None = None,
    resume: Path | None = None,
    progress: bool = True,
) -> Path:
    """Optimize a linear frontier score by CMA-ES; return the run folder, by default as that of a training.

    A resumed run restores the optimizer from stored objective values of finished generations. `run`: another folder for
    results. `resume`: run folder to resume. Raises the errors of `lidarnaut.train`; also ValueError if a new folder
    already holds a run.
    """
    with contextlib.ExitStack() as held:
        pool = held.enter_context(make_pool(config.num_workers))
        run = held.enter_context(begin(config, "evolution", run, resume))
        evolution = _Evolution(config, run, pool)
        bar = Progress(total=config.generations, initial=len(evolution.values), disable=not progress, unit="generation")
        try:
            with bar, evolution.log:
                evolution.prepare()
                for generation in range(config.generations):
                    if generation % config.validate_every == 0:
                        bar.set_postfix(time_over_rule=f"{evolution.validate(generation):.3f}")
                    bar.update(evolution.advance(generation))
                reached = evolution.validate(config.generations)
                bar.set_postfix(time_over_rule=f"{reached:.3f}")
        except KeyboardInterrupt:
            done = f"after generation {len(evolution.values)}"
            raise KeyboardInterrupt(f"{done}; resume with --resume {run}") from None
        record = {"generation": config.generations, "time_over_rule": reached, "seed": config.seed}
        shutil.rmtree(run / POLICY, ignore_errors=True)
        FrontierScore(evolution.policy(config.generations)).save(run / POLICY, record)
    return run


class _Evolution:
    def __init__(self, config: EvolutionConfig, run: Path, pool: Executor) -> None:
        self._config, self._run, self._pool = config, run, pool
        self.values = _read(run / GENERATIONS, config.population)
        """Objective values by generation, shape (population,), float64: each individual's mean log(exploration time /
        time of the rule `gain_over_cost`)."""
        self._means: list[np.ndarray] = []
        self._validated: list[Row] = read_evaluations(run) if (run / "evaluations.csv").exists() else []
        seed, population = config.seed, config.population
        self._strategy = CMA(np.zeros(NUM_FEATURES), config.sigma, seed=seed, population_size=population)
        self._tasks = _tasks(config, VALIDATION_SEED, config.validation_tasks)
        self.log = SummaryWriter(str(run / "tensorboard"), purge_step=len(self.values))

    def prepare(self) -> None:
        tasks = _tasks(self._config, SCALING_SEED, self._config.tasks)
        variances = list(self._pool.map(feature_variances, tasks))
        self._spread = np.sqrt(np.mean(variances, axis=0)).clip(LEAST_SPREAD)

    def validate(self, generation: int) -> float:
        self._measure("nearest", NEAREST, 0)
        row = self._measure(LEARNED, self.policy(generation), generation)
        rows = sorted(self._validated, key=lambda one: (one["policy"] == LEARNED, one["steps"]))
        title = f"{self._config.experiment}, evolution, seed {self._config.seed}"
        write_evaluations(self._run, rows, title, "generations")
        return float(row["time_over_rule"])

    def advance(self, generation: int) -> int:
        individuals = [self._strategy.ask() for _ in range(self._config.population)]
        is_new = generation == len(self.values)
        if is_new:
            tasks = _tasks(self._config, GENERATION_SEED, self._config.tasks, generation)
            weights = [PRIOR + individual / self._spread for individual in individuals]
            self.values.append(self._compare(tasks, weights)[:, :, 0].mean(axis=0))
            table = io.StringIO()
            np.savetxt(table, self.values, fmt="%.17g", delimiter=",")
            write_file(self._run / GENERATIONS, table.getvalue())
            self.log.add_scalar("evolution/time_over_rule", np.exp(self.values[-1].mean()), generation)
        self._strategy.tell(list(zip(individuals, self.values[generation].tolist(), strict=True)))
        self._means.append(self._strategy.mean.copy())
        return int(is_new)

    def policy(self, generation: int) -> np.ndarray:
        means = self._means[generation // 2 : generation]
        return PRIOR + np.mean(means, axis=0) / self._spread if means else PRIOR

    def _measure(self, policy: str, weights: np.ndarray, generation: int) -> Row:
        for row in self._validated:
            if (row["policy"], row["steps"]) == (policy, generation):
                return row
        ratios, explored = self._compare(self._tasks, [weights])[:, 0].T
        low, high = np.exp(np.quantile(ratios, (0.25, 0.75))).tolist()
        values = {"progress": float(explored.mean()), "success": float((explored >= TARGET).mean())}
        values |= {"time_over_rule": float(np.exp(ratios.mean()))}
        values |= {"time_over_rule_q25": low, "time_over_rule_q75": high}
        scores = " ".join(f"{ratio:.5g}" for ratio in np.exp(ratios))
        if policy == LEARNED:
            for name, value in values.items():
                self.log.add_scalar(f"evaluation/{name}", value, generation)
        self._validated.append({"policy": policy, "steps": generation, **values, SCORES: scores})
        return self._validated[-1]

    def _compare(self, tasks: list[ExplorationTask], weights: list[np.ndarray]) -> np.ndarray:
        jobs = [self._pool.submit(compare, task, weights) for task in tasks]
        return np.array([job.result() for job in jobs])


def _tasks(config: EvolutionConfig, stream: int, count: int, step: int = 0) -> list[ExplorationTask]:
    seeds = ([config.seed, stream, step, i] for i in range(count))
    return [draw_task(np.random.default_rng(seed), config.families) for seed in seeds]


def _read(path: Path, width: int) -> list[np.ndarray]:
    if not path.exists():
        return []
    try:
        rows = np.loadtxt(io.BytesIO(read_bytes(path)), delimiter=",", ndmin=2)
    except ValueError as error:
        raise CheckpointError(f"{path} does not hold numbers: {error}") from error
    if rows.shape[1] != width:
        raise CheckpointError(f"{path} does not hold rows of {width} numbers")
    return list(rows)
