"""Measurement of the reference policies of a training in its test episodes."""

import contextlib
import logging
from collections.abc import Mapping

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import TEST, Row
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.pools import make_pool
from lidarnaut.envs.processes import interrupts_held
from lidarnaut.envs.progress import Progress

LOGGER = logging.getLogger(__name__)
_measured_by: list[tuple[TrainingConfig, Evaluator]] = []


def measure_references(
    config: TrainingConfig, evaluator: Evaluator, names: Mapping[str, str], *, progress: bool = True
) -> list[Row]:
    """Return a row of the evaluation table for each reference policy.

    Episodes run in `environment.num_workers` processes; with 0 or `vectorization: sync`, in this one. `names`: names in
    the table, by name of the policy.
    """
    environment, seeds, rows = config.environment, range(config.evaluation.num_tests), list[Row]()
    num_workers = 0 if environment.vectorization == "sync" or not names else environment.num_workers
    bar = Progress(total=len(names) * len(seeds), desc="references", unit="episode", leave=False, disable=not progress)
    with bar, contextlib.nullcontext() if num_workers == 0 else make_pool(num_workers, None) as pool:
        with interrupts_held():
            jobs = {name: [pool.submit(_measure, config, name, seed) for seed in seeds if pool] for name in names}
        for name, label in names.items():
            values = list[dict[str, float]]()
            try:
                for job in jobs[name]:
                    values.append(job.result())
                    bar.update()
            except Exception as error:  # such as objects of the main script, which workers cannot import
                LOGGER.info("%s is measured in this process: %s: %s", name, type(error).__name__, error)
            for seed in seeds[len(values) :]:
                values.append(evaluator.reference(name, seed))
                bar.update()
            rows.append({"policy": label, "split": TEST, "steps": 0, **evaluator.summarise(label, TEST, values)})
    return rows


def _measure(config: TrainingConfig, name: str, seed: int) -> dict[str, float]:
    if not _measured_by or _measured_by[0][0] != config:
        _measured_by[:] = [(config, Evaluator(config))]
    return _measured_by[0][1].reference(name, seed)
