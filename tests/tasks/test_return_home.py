import math
import pickle

import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines.episode import begin_episode, decide_with, run
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.abstract import ExploreFrontiersAbstractEnv
from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.tasks.explore import HOME_RADIUS, Explore, ExploreTeam
from tests.rollouts import nearest, rollout

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "return_home": True}


class Tired:
    def __init__(self, patience):
        self._explorer, self._patience, self.end_reason = make_policy("nearest"), patience, None

    plan = property(lambda self: self._explorer.plan)

    def reset(self, *arguments):
        self._explorer.reset(*arguments)

    def act(self, reading, belief):
        self._patience -= 1
        self.end_reason = None if self._patience else "tired"
        return self._explorer.act(reading, belief)


def explore(explorer, **arguments):
    env, infos = LidarEnv(Explore, **QUICK, **arguments), []
    start = begin_episode(env, explorer, 3, np.random.default_rng(0))
    run(env, decide_with(explorer, env), *start, infos.append)
    return env, infos


def distance_home(env):
    (x, y, _), (home_x, home_y, _) = env.truths[0].state.pose, env.map_pose
    return math.hypot(x - home_x, y - home_y)


def test_the_episode_ends_at_the_start_once_the_world_is_explored():
    env, infos = explore(make_policy("nearest"), control_hz=5.0)
    last = infos[-1]
    assert (last["end_reason"], last["returned"], last["is_success"]) == ("returned", True, True)
    assert distance_home(env) <= HOME_RADIUS
    assert env.task.rewards.weights == {**Explore.weights, "returned": 10.0}
    # At the start the robot is at home as well, but has not returned.
    assert not any(info["returned"] for info in infos[:-1])
    covered = next(k for k, info in enumerate(infos) if info["explored_fraction"] >= env.task.target_coverage)
    assert 0 < covered < len(infos) - 1
    assert infos[covered]["time_home"] == 0.0
    assert last["time_home"] == pytest.approx(last["time"] - infos[covered]["time"])
    paid = {name: [k for k, i in enumerate(infos) if i["rewards"][name]] for name in ("completed", "returned")}
    assert paid == {"completed": [covered], "returned": [len(infos) - 1]}


def test_a_robot_whose_explorer_stops_early_returns_without_success():
    env, infos = explore(Tired(40), control_hz=5.0)
    assert explore(Tired(20), control_hz=5.0, time_limit=4.2)[1][-1]["end_reason"] == "time_limit"
    assert infos[-1]["returned"]
    assert not infos[-1]["is_success"]
    assert infos[-1]["explored_fraction"] < env.task.target_coverage
    assert distance_home(env) <= HOME_RADIUS


def test_the_last_decision_drives_home():
    env = ExploreFrontiersEnv(**QUICK)
    observation, reward, terminated, _, info = rollout(env, 3, 100, nearest)[-1]
    assert env.observation_space.contains(observation)
    assert (terminated, info["end_reason"], info["is_success"]) == (True, "returned", True)
    assert distance_home(env.explore) <= HOME_RADIUS
    assert info["rewards"]["returned"] == 10.0
    assert reward == pytest.approx(sum(info["rewards"].values()))
    assert info["decision_time"] >= info["time_home"] > 0.0


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("tasks.explore.HOME_RADIUS", 0.0, "arrived_home"),
        ("navigation.goals.goal_navigator.HOME", (40.0, 0.0), "no_path_home"),
    ],
)
def test_a_robot_that_does_not_get_there_has_not_returned(name, value, reason, monkeypatch):
    """The estimated pose is at home, but the true pose is too far away; or the map shows no path."""
    monkeypatch.setattr(f"lidarnaut.envs.{name}", value)
    *_, terminated, _, info = rollout(ExploreFrontiersEnv(**QUICK), 3, 100, nearest)[-1]
    assert terminated
    assert (info["end_reason"], info["returned"], info["is_success"]) == (reason, False, False)


def test_policies_see_where_home_is():
    env = pickle.loads(pickle.dumps(LidarEnv(Explore, **QUICK, slam="truth", start="spawn")))
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation["home"][:2], 0.0, atol=1e-6)
    env.task.call_back()
    for _ in range(5):
        observation, *_ = env.step(np.array([0.0, 1.0], dtype=np.float32))
    x, y, theta = env.belief.pose
    flag, distance, cosine, sine = observation["home"]
    assert flag == 1.0
    assert distance == pytest.approx(math.hypot(x, y) / 32.0, abs=1e-6)
    to_home = np.array([math.cos(theta) * -x - math.sin(theta) * y, math.sin(theta) * x - math.cos(theta) * y])
    np.testing.assert_allclose([cosine, sine], to_home / np.linalg.norm(to_home), atol=1e-5)


def test_what_cannot_return_says_so():
    with pytest.raises(ValueError, match="return_home is for one robot"):
        LidarEnv(ExploreTeam, **QUICK)
    with pytest.raises(ValueError, match="'return_home' has no effect"):
        ExploreFrontiersAbstractEnv(return_home=True)
    with pytest.raises(ValueError, match="return_home=True"):
        LidarEnv(Explore, physics="kinematic").task.call_back()
