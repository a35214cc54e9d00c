from agents.config import TrainingConfig
from benchmarks.decisions_training import measure
from envs.files import parse_record
from tests.agents.test_decisions import DATA


def test_everything_takes_longer_than_the_environments_alone():
    decisions, seconds, stepping = measure(parse_record(DATA, "choices", TrainingConfig), updates=2)
    assert decisions == 64
    assert 0.0 < stepping < seconds
