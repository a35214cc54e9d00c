from functools import cache

import pytest

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.training import train
from lidarnaut.envs.files import parse_record
from tests.agents.fake_env import ID
from tests.agents.tiny import tiny

TINY = {"experiment": "tiny", "total_steps": 768, "num_envs": 4, "algorithm": "PPO"}
TINY |= {
    "environment": {"id": ID, "vectorization": "sync", "time_limit": 4.0},
    "hyperparameters": {"n_steps": 32, "batch_size": 64, "n_epochs": 2},
    "evaluation": {"every": 256, "at_start": True, "episodes": 3, "references": []},
    "checkpoints": {"every": 256, "keep": 2},
}
"""Experiment of one second; an update takes 128 steps."""


@pytest.fixture(scope="session")
def tiny_data():
    return TINY


@pytest.fixture(scope="session")
def tiny_config():
    return parse_record(TINY, "tiny", TrainingConfig)


@pytest.fixture(scope="session")
def tiny_run(tiny_config, tmp_path_factory):
    return train(tiny_config, run=tmp_path_factory.mktemp("runs") / "tiny", progress=False)


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """Return a function that trains an algorithm on an id once; tests copy the folder before they change it."""

    @cache
    def make(algorithm, id):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("lidarnaut.agents.run_folder.draw_learning_curve", lambda *args: None)
            config = tiny(algorithm, id, evaluation={"episodes": 1, "every": 1000, "references": []})
            return config, train(config, run=tmp_path_factory.mktemp(algorithm) / "run", progress=False)

    return make


@pytest.fixture(autouse=True)
def brief(no_curves, no_workers):
    """Trainings draw no curves and start no workers."""
