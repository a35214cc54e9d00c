import contextlib
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pytest

from lidarnaut.agents import references
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.references import measure_references
from lidarnaut.agents.training import train
from lidarnaut.baselines.policy import Explorer
from tests.agents.tiny import tiny

NAMES = {"pursuit": "pursuit", "random": "random [oracle]"}


def reach(**changes):
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "world_size": [6, 6], "time_limit": 1.0}
    evaluation = {"every": 16, "episodes": 1, "test_episodes": 2, "references": ["pursuit", "random"]}
    return tiny("PPO", "Explore", environment={**environment, "num_workers": 0, **changes}, evaluation=evaluation)


class Lost(Executor):
    """Executor whose workers die after the first episode."""

    def __init__(self):
        self.num_jobs = 0

    def submit(self, function, *args):
        self.num_jobs += 1
        job = Future()
        job.set_result(function(*args)) if self.num_jobs == 1 else job.set_exception(ImportError("no such script"))
        return job


def test_references_are_measured_once_at_the_end_in_their_order_and_in_any_process(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(references, "make_pool", lambda *_: pytest.fail("there are no workers"))
    caplog.set_level("INFO", "lidarnaut")
    config, ran = reach(), []
    run, reference = Evaluator.reference, lambda *args: ran.append(args[1:]) or run(*args)
    monkeypatch.setattr(Evaluator, "reference", reference)
    folder = train(config, run=tmp_path / "run", progress=False)
    assert ran == [(name, seed) for name in ("pursuit", "random") for seed in (0, 1)]
    rows = read_evaluations(folder)
    assert [(row["policy"], row["split"], row["steps"]) for row in rows] == [
        ("pursuit", "test", 0), ("random", "test", 0), ("learned", "validation", 0), ("learned", "validation", 16),
        ("learned", "test", 16),
    ]  # fmt: skip
    with contextlib.closing(Evaluator(config)) as evaluator:
        alone = measure_references(config, evaluator, NAMES, progress=False)
        assert [(row["policy"], row["scores"]) for row in alone] == [
            (name, row["scores"]) for name, row in zip(NAMES.values(), rows, strict=False)
        ]
        for pool in (ThreadPoolExecutor(1), Lost()):
            monkeypatch.setattr(references, "make_pool", lambda *_, pool=pool: contextlib.nullcontext(pool))
            assert measure_references(reach(num_workers=None), evaluator, NAMES, progress=False) == alone
    assert "pursuit is measured in this process: ImportError: no such script" in caplog.text


class Faulty(Explorer):
    def act(self, reading, belief):
        raise KeyError("a bug of mine")


def test_a_reference_that_fails_names_its_own_error(monkeypatch):
    monkeypatch.setattr(references, "make_pool", lambda *_: contextlib.nullcontext(ThreadPoolExecutor(1)))
    config = reach(num_workers=None)
    name = f"{__name__}:Faulty"
    with contextlib.closing(Evaluator(config)) as evaluator, pytest.raises(KeyError, match="a bug of mine"):
        measure_references(config, evaluator, {name: name}, progress=False)
