import shutil
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

import lidarnaut
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.frontiers.score import PRETRAINED, PursuitScoreExplorer, ScoreExplorer
from lidarnaut.agents.policies import make_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines import (
    FrontierExplorer,
    PursuitExplorer,
    RouteFollower,
    RrtExplorer,
    TeamExplorer,
    TourExplorer,
)
from lidarnaut.baselines.adoption import adopt
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.baselines.policy import OnePerRobot
from lidarnaut.baselines.reactive import RandomChooser
from lidarnaut.envs.navigation import DockNavigator, GoalNavigator
from tests.own_code import Circling

BOX = spaces.Box(-1.0, 1.0, (2,), np.float32)
SEEN = {"scan": np.ones(3), "action_mask": np.array([0, 1], dtype=np.int8)}


class Model:
    def predict(self, observation, state=None, episode_start=None, deterministic=False, action_masks=None):
        self.seen = (state, bool(episode_start[0]), deterministic, action_masks)
        return np.array([3.0, -0.5]), (state or 0) + 1


def drive(policy, steps=1):
    policy.reset(SimpleNamespace(name="robot"), 0.1, np.random.default_rng(0))
    return [policy(SEEN) for _ in range(steps)]


def test_rules_over_candidates_are_driven():
    class Memory:
        def __call__(self, candidates, belief):
            return 0

    for rule in (lambda candidates, belief: 0, Memory, Memory()):
        explorer = make_policy(rule)
        assert isinstance(explorer, RuleExplorer)
        assert explorer.rule(None, None) == 0


def test_callables_get_the_observation_and_their_actions_are_cut_to_the_bounds():
    for source in (lambda seen: 2.0 * seen["scan"][:2], lambda: lambda seen: 2.0 * seen["scan"][:2]):
        (action,) = drive(make_policy(source, BOX))
        assert action.dtype == np.float32
        assert action.tolist() == [1.0, 1.0]
    (choice,) = drive(make_policy(lambda seen: 1.0, spaces.Discrete(2)))
    assert spaces.Discrete(2).contains(choice)


def test_models_are_asked_as_they_expect():
    model = Model()
    policy = make_policy(model, BOX)
    assert [action.tolist() for action in drive(policy, 2)] == [[1.0, -0.5]] * 2
    assert model.seen == (1, False, True, SEEN["action_mask"])
    drive(policy)
    assert model.seen[:2] == (None, True)  # a new episode
    for others in ((), (None,), ("log_prob", "value")):
        model = SimpleNamespace(predict=lambda observation, others=others: (np.array([0.5, 0.0]), *others))
        assert drive(make_policy(model, BOX))[0].tolist() == [0.5, 0.0]
    plain = SimpleNamespace(predict=lambda observation: observation["scan"][:2])
    plain.reset = lambda robot, control_period, rng=None: setattr(plain, "robot", robot.name)
    assert drive(make_policy(plain, BOX))[0].tolist() == [1.0, 1.0]
    assert plain.robot == "robot"


def test_reset_plan_reason_and_level_of_a_policy_are_used():
    class Stopping:
        end_reason, plan, level = "bored", np.zeros((1, 2)), "twist"

        def reset(self, robot, control_period, rng):
            self.robot = robot

        def __call__(self, observation):
            return np.array([0.0, float(self.robot.name == "robot")])

    policy = make_policy(Stopping, BOX)
    assert drive(policy)[0].tolist() == [0.0, 1.0]
    assert (policy.end_reason, policy.plan.shape, policy.level) == ("bored", (1, 2), "twist")
    policy = make_policy(lambda seen: np.zeros(2), BOX)
    assert policy.end_reason is policy.plan is policy.level is None
    with pytest.raises(ValueError, match="must be one of twist, decision, got 'goal'"):
        make_policy(SimpleNamespace(level="goal", predict=lambda observation: 0))


def test_what_cannot_explore_is_refused():
    with pytest.raises(ValueError, match="7 is not an explorer, rule or callable of an observation, and lacks predict"):
        make_policy(7)
    for name in ("pursuit", Path("runs")):
        with pytest.raises(ValueError, match=r"is a name, not a policy: lidarnaut.make_policy\(NAME, env\)"):
            adopt(name)


NAMED = {
    "rrt?eta_local=0.5": RrtExplorer,
    "frontier:published?sim_time=1.7,min_frontier_size=5": FrontierExplorer,
    "mine=tour?hysteresis=3": TourExplorer,
    "pursuit": PursuitExplorer,
    "pursuit:fast": GoalNavigator,
    "mppi": GoalNavigator,
    "dock": DockNavigator,
    "route_follower": RouteFollower,
    "mtsp": TeamExplorer,
    "learned:pretrained/frontiers": ScoreExplorer,
    "pretrained/frontiers": ScoreExplorer,
    "pursuit:pretrained/frontiers": PursuitScoreExplorer,
    "pretrained/reach?deterministic=false": LearnedPolicy,
    "label=pretrained/reach": LearnedPolicy,
    "tests.own_code:Circling": Circling,
}


@pytest.mark.parametrize("name", NAMED)
def test_all_names_of_the_command_line_make_policies(name):
    assert isinstance(make_policy(name), NAMED[name])


def test_a_folder_makes_its_policy_and_an_environment_chooses_among_policies_of_the_same_name(tmp_path, monkeypatch):
    assert isinstance(make_policy(PRETRAINED / "frontiers"), ScoreExplorer)
    assert isinstance(make_policy(str(PRETRAINED / "frontiers")), ScoreExplorer)
    shutil.copytree(PRETRAINED / "frontiers", tmp_path / "mine")
    monkeypatch.chdir(tmp_path)
    assert isinstance(make_policy("mine"), ScoreExplorer)
    for id, name, kind in (
        ("ReachGoal", "pursuit", GoalNavigator),
        ("Explore", "pursuit", PursuitExplorer),
        ("ExploreFrontiers", "random", RandomChooser),
        ("ExploreTeam", "random", OnePerRobot),
        ("ExploreTeam", "pretrained/frontiers", OnePerRobot),
    ):
        with gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic") as env:
            policy = make_policy(name, env)
            assert isinstance(policy, kind), id
            run_episode(TimeLimit(env, 2), policy, 0)
    with (
        gymnasium.make("lidarnaut/ReachGoal-v0", physics="kinematic") as env,
        pytest.raises(ValueError, match=r"policy 'rrt\?eta_local=0.5' cannot do this task; allowed are pursuit"),
    ):
        make_policy("rrt?eta_local=0.5", env)


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("rtt", ValueError, "unknown policy 'rtt' .did you mean 'rrt'"),
        ("rrt?eta=1", ValueError, "unknown parameter 'eta'"),
        ("pretrained/nobody", CheckpointError, "available are pretrained/crowd"),
        ("runs/nothing", CheckpointError, "runs/nothing is not a folder"),
        ("no_such_module:Mine", ValueError, "no module 'no_such_module'"),
    ],
)
def test_wrong_names_are_explained(name, error, message):
    with pytest.raises(error, match=message):
        make_policy(name)


def test_names_of_earlier_versions_make_policies_or_name_the_right_call():
    assert lidarnaut.make_explorer is lidarnaut.make_policy
    assert not {"make_explorer", "load_policy"} & {*dir(lidarnaut)}
    assert isinstance(lidarnaut.load_policy("pretrained/frontiers", pursuit=True), PursuitScoreExplorer)
    with pytest.raises(CheckpointError, match=r"pursuit is a classic policy.*lidarnaut.make_policy\('pursuit'\)"):
        lidarnaut.load_policy("pursuit")
