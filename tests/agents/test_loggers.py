"""Trainings log numbers by the packages of Weights & Biases and MLflow, without a network."""

import importlib.util
import json

import pytest

from lidarnaut.agents import loggers
from lidarnaut.agents.training import train
from lidarnaut.train_command import main
from tests.agents.test_training import changed


def has(package):
    return getattr(importlib.util.find_spec(package), "origin", None) is not None


needs_mlflow = pytest.mark.skipif(not has("mlflow"), reason="needs MLflow: pip install 'lidarnaut[mlflow]'")
needs_wandb = pytest.mark.skipif(not has("wandb"), reason="needs Weights & Biases: pip install 'lidarnaut[wandb]'")


def train_twice(data, run, **changes):
    """Train, and resume from the checkpoint before the last; return the ids of the run in both."""
    config = changed(data, total_steps=512, **changes)
    ids = [json.loads((train(config, run=run, progress=False) / loggers.RUN_IDS).read_text())]
    train(config.model_copy(update={"total_steps": 640}), resume=f"{run}@256", progress=False)
    return *ids, json.loads((run / loggers.RUN_IDS).read_text())


@needs_mlflow
def test_mlflow_has_the_numbers_of_each_update_and_a_resumed_training_goes_on(tiny_data, tmp_path, monkeypatch):
    import mlflow

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", store := f"sqlite:///{tmp_path}/mlflow.db")
    mlflow.set_tracking_uri(store)
    first, second = train_twice(tiny_data, tmp_path / "run", logger=["mlflow"])
    assert first == second
    assert mlflow.active_run() is None
    assert not (tmp_path / "run" / "tensorboard").exists()
    client = mlflow.MlflowClient(store)
    run = client.get_run(first["mlflow"])
    assert (run.info.run_name, run.info.status) == ("run", "FINISHED")
    assert run.data.params["hyperparameters.n_steps"] == "32"
    losses = client.get_metric_history(first["mlflow"], "train/loss")
    assert sorted({one.step for one in losses}) == [128, 256, 384, 512, 640]
    tested = client.get_metric_history(first["mlflow"], "evaluation/area")
    assert sorted({one.step for one in tested}) == [0, 256, 512, 640]


@needs_wandb
def test_wandb_has_the_numbers_of_each_update_and_a_resumed_training_goes_on(tiny_data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    logged, whole = [], loggers.WeightsAndBiases._log
    monkeypatch.setattr(loggers.WeightsAndBiases, "_log", lambda *args: (logged.append(args[1:]), whole(*args)))
    first, second = train_twice(tiny_data, tmp_path / "run", logger=["wandb", "tensorboard"])
    assert first == second
    folders = list((tmp_path / "wandb").glob(f"offline-run-*-{first['wandb']}"))
    assert len(folders) == 2
    assert all(list(folder.glob("*.wandb")) for folder in folders)
    assert (tmp_path / "run" / "tensorboard").is_dir()
    assert [step for numbers, step in logged if "train/loss" in numbers] == [128, 256, 384, 512, 384, 512, 640]
    assert [step for numbers, step in logged if "evaluation/area" in numbers] == [0, 256, 512, 512, 640]


@pytest.mark.parametrize("name", ["wandb", "mlflow"])
def test_a_missing_package_is_named_with_its_extra_before_anything_is_written(name, tmp_path, monkeypatch, capsys):
    (tmp_path / name).mkdir()  # a folder of results is no package
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    assert main(["--environment.id", "lidarnaut/ReachGoal-v0", "--logger", name]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.endswith(
        f"logger {name} needs the package {name}: pip install 'lidarnaut[{name}]', or -e '.[{name}]' in a checkout"
    )
    assert not (tmp_path / "runs").exists()


def test_an_unknown_logger_is_refused_with_those_that_exist(capsys):
    assert main(["--environment.id", "lidarnaut/ReachGoal-v0", "--logger", "tensorbord"]) == 2
    assert "'tensorboard', 'wandb' or 'mlflow'" in capsys.readouterr().err
