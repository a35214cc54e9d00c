"""Loggers of trainings, as output formats of stable-baselines3: TensorBoard, Weights & Biases, MLflow."""

import importlib.util
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from stable_baselines3.common.logger import KVWriter, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from lidarnaut.agents.recipes import flat
from lidarnaut.envs.files import parse_record, read_json, read_mapping, write_file

RUN_IDS = "loggers.json"
"""File of a run folder with the ids of the run in Weights & Biases and MLflow, which a resumed training continues."""


class TensorBoard(TensorBoardOutputFormat):
    """TensorBoard writer that hides events logged after the resumed checkpoint."""

    def __init__(self, run: Path, purge_step: int | None) -> None:
        self.writer = SummaryWriter(str(run / "tensorboard"), purge_step=purge_step)
        self._is_closed = False


class Tracker(KVWriter):
    """Base of writers to experiment trackers, whose packages are optional; their environment variables apply."""

    name: ClassVar[str]
    """Name of the package, of the extra that installs it, and of the logger."""
    _begin: Callable[..., str]
    _log: Callable[..., Any]

    def __init__(self, run: Path, purge_step: int | None) -> None:
        self._package: Any = importlib.import_module(self.name)
        file = run / RUN_IDS
        ids = parse_record(read_json(file), str(file), dict[str, str]) if file.exists() else {}
        ids[self.name] = self._begin(run.name, read_mapping(run / "config.yaml"), ids.get(self.name))
        write_file(file, json.dumps(ids))

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        numbers = {key: float(one) for key, one in key_values.items() if isinstance(one, int | float | np.number)}
        self._log({key: number for key, number in numbers.items() if np.isfinite(number)}, step)


class WeightsAndBiases(Tracker):
    """Writer to Weights & Biases, with the x-axis `steps`."""

    name = "wandb"

    def _begin(self, name: str, config: Mapping[str, Any], id: str | None) -> str:
        # Its files are not in the run folder, which may hold no links. Its own step must not decrease on resume.
        self._run = self._package.init(name=name, config=dict(config), id=id, resume="allow")
        self._run.define_metric("*", step_metric="steps")
        return str(self._run.id)

    def _log(self, numbers: dict[str, float], step: int) -> None:
        self._run.log({**numbers, "steps": step})

    def close(self) -> None:
        self._run.finish()


class MLflow(Tracker):
    """Writer to MLflow."""

    name = "mlflow"

    def _begin(self, name: str, config: Mapping[str, Any], id: str | None) -> str:
        mlflow, parameters = self._package, [] if id else [*flat(config)]
        self._run = mlflow.start_run(run_id=id, run_name=name, nested=mlflow.active_run() is not None)
        for first in range(0, len(parameters), 100):  # at most in a request
            mlflow.log_params(dict(parameters[first : first + 100]))
        return str(self._run.info.run_id)

    def _log(self, numbers: dict[str, float], step: int) -> None:
        self._package.log_metrics(numbers, step=step, run_id=self._run.info.run_id)

    def close(self) -> None:
        self._package.end_run()


LOGGERS: dict[str, Any] = {"tensorboard": TensorBoard, "wandb": WeightsAndBiases, "mlflow": MLflow}


def check_loggers(names: Iterable[str]) -> None:
    """Raise ImportError if the package of a logger is missing."""
    for name in names:
        if getattr(importlib.util.find_spec(name), "origin", None) is None:  # folders `wandb` are no packages
            extra = f"pip install 'lidarnaut[{name}]', or -e '.[{name}]' in a checkout"
            raise ImportError(f"logger {name} needs the package {name}: {extra}")
