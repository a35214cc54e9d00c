"""Loggers of trainings, as output formats of stable-baselines3: TensorBoard, Weights & Biases, MLflow."""

import importlib.util
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from stable_baselines3.common.logger import KVWriter, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from lidarnaut.agents.recipes import flat
from lidarnaut.envs.files import read_json, read_mapping, write_file

RUN_IDS = "loggers.json"
"""File of a run folder with the ids of the run in Weights & Biases and MLflow, which a resumed training continues."""


class TensorBoard(TensorBoardOutputFormat):
    """TensorBoard writer that hides events logged after the resumed checkpoint."""

    def __init__(self, run: Path, purge_step: int | None) -> None:
        self.writer = SummaryWriter(str(run / "tensorboard"), purge_step=purge_step)
        self._is_closed = False


class Tracker(KVWriter):
    """Base of writers of numbers to experiment trackers, which are optional packages."""

    name: ClassVar[str]
    """Name of the package, of the extra that installs it, and of the logger."""

    def __init__(self, run: Path, purge_step: int | None) -> None:
        self._package: Any = importlib.import_module(self.name)
        ids = read_json(run / RUN_IDS) if (run / RUN_IDS).exists() else {}
        ids[self.name] = self._begin(run, read_mapping(run / "config.yaml"), ids.get(self.name))
        write_file(run / RUN_IDS, json.dumps(ids))

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        """Log the finite numbers of a mapping at an environment step."""
        numbers = {key: value for key, value in key_values.items() if isinstance(value, int | float | np.number)}
        self._log({key: float(value) for key, value in numbers.items() if np.isfinite(value)}, step)

    def _begin(self, run: Path, config: Mapping[str, Any], id: str | None) -> str:
        """Begin a run with a configuration, or continue that with an id; return its id."""
        raise NotImplementedError

    def _log(self, numbers: dict[str, float], step: int) -> None:
        raise NotImplementedError


class WeightsAndBiases(Tracker):
    """Weights & Biases, with the x-axis `steps`; environment variables such as WANDB_PROJECT and WANDB_MODE apply."""

    name = "wandb"

    def _begin(self, run: Path, config: Mapping[str, Any], id: str | None) -> str:
        # Its files are not in the run folder, which may hold no links. Its own step must not decrease on resume.
        self._run = self._package.init(name=run.name, config=dict(config), id=id, resume="allow")
        self._run.define_metric("*", step_metric="steps")
        return str(self._run.id)

    def _log(self, numbers: dict[str, float], step: int) -> None:
        self._run.log({**numbers, "steps": step})

    def close(self) -> None:
        self._run.finish()


class MLflow(Tracker):
    """MLflow; environment variables such as MLFLOW_TRACKING_URI and MLFLOW_EXPERIMENT_NAME apply."""

    name = "mlflow"

    def _begin(self, run: Path, config: Mapping[str, Any], id: str | None) -> str:
        mlflow = self._package
        self._run = mlflow.start_run(run_id=id, run_name=run.name, nested=mlflow.active_run() is not None)
        parameters = [] if id else [*flat(config)]
        for first in range(0, len(parameters), 100):  # at most in a request
            mlflow.log_params(dict(parameters[first : first + 100]))
        return str(self._run.info.run_id)

    def _log(self, numbers: dict[str, float], step: int) -> None:
        self._package.log_metrics(numbers, step=step, run_id=self._run.info.run_id)

    def close(self) -> None:
        self._package.end_run()


LOGGERS: dict[str, Any] = {"tensorboard": TensorBoard, "wandb": WeightsAndBiases, "mlflow": MLflow}
"""Output format of each logger, by name."""


def check_loggers(names: Iterable[str]) -> None:
    """Raise ImportError if the package of a logger is missing."""
    for name in names:
        if getattr(importlib.util.find_spec(name), "origin", None) is None:  # folders `wandb` are no packages
            extra = f"pip install 'lidarnaut[{name}]', or -e '.[{name}]' in a checkout"
            raise ImportError(f"logger {name} needs the package {name}: {extra}")
