"""Classic policies with parameters changed: `nearest?max_time=8`."""

import pickle
from pathlib import Path

import pytest

from benchmarks.arena.policies import parse_policy
from benchmarks.arena.settings import Settings
from envs.files import read_record

EXPERIMENTS = Path(__file__).parents[2] / "configs" / "experiments"


def test_parameters_of_a_policy_and_of_its_navigator_are_set_by_name():
    policy = parse_policy("mine=tour?hysteresis=3,max_stops=8,max_time=.inf,inflation=0.2,view_distances=[0.0, 0.5]")
    assert policy.name == "mine"
    explorer = pickle.loads(pickle.dumps(policy)).make()
    params = explorer.rule._params
    assert (params.hysteresis, params.max_stops) == (3.0, 8)
    assert (explorer.max_time, explorer.planning.inflation) == (float("inf"), 0.2)
    assert list(explorer.planning.view_distances) == [0.0, 0.5]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tour?max_tme=1", r"policy 'tour\?max_tme=1': unknown parameter 'max_tme' \(did you mean 'max_time'\?\)"),
        ("random?speed=1", "allowed are none"),
        ("nearest?max_time=fast", r"policy 'nearest\?max_time=fast': could not convert"),
        ("tour?", "unknown policy"),
    ],
)
def test_unknown_parameters_are_refused(name, message):
    with pytest.raises(ValueError, match=message):
        parse_policy(name)


@pytest.mark.parametrize("path", sorted(EXPERIMENTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_experiments_have_policies_that_can_be_made(path):
    for name in read_record(path, Settings).policies:
        parse_policy(name)
