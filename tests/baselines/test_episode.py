import math
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import baselines.episode
from baselines.episode import run, run_episode
from envs.simulation import Twist


class ScriptedEnv(gymnasium.Env):
    """Explores by itself: 2 s and 0.5 m per step, a fraction from a list per step, position errors of 3 and 4 cm."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    robot = SimpleNamespace(max_v=0.5, max_w=1.0)
    control_period = 2.0
    plan = None
    reading = None

    def __init__(self, fractions, time_limit, target=0.99):
        self.fractions, self.time_limit, self.target = fractions, time_limit, target
        self.coverage = SimpleNamespace(area=SimpleNamespace(area=50.0))
        self.belief = SimpleNamespace(grid=None)
        self.start = None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.step_number = 0
        return {}, self._info()

    def step(self, action):
        self.step_number += 1
        terminated = self.fractions[self.step_number] >= self.target
        truncated = not terminated and 2.0 * self.step_number >= self.time_limit
        info = self._info()
        if terminated or truncated:
            info |= {"map_iou": 0.8, "end_reason": "covered" if terminated else "time_limit"}
        return {}, 0.0, terminated, truncated, info

    def _info(self):
        k = self.step_number
        return {
            "explored_fraction": self.fractions[k],
            "explored_area": 50.0 * self.fractions[k],
            "pose_error": np.array([[0.03, 0.04][k % 2], 0.1]),
            "path_length": 0.5 * k,
            "collisions": k // 2,
            "time": 2.0 * k,
            "rewards": {},
            "is_success": self.fractions[k] >= self.target,
        }


class ScriptedExplorer:
    """Stops with a reason at its n-th decision."""

    plan = np.zeros((1, 2))

    def __init__(self, stop_at=10**9):
        self.stop_at = stop_at

    def reset(self, robot, control_period, rng):
        self.end_reason = None
        self.decisions = 0
        self.draw = rng.random()

    def act(self, reading, belief):
        self.decisions += 1
        if self.decisions == self.stop_at:
            self.end_reason = "no_reachable_frontier"
        return Twist(0.0, 0.0)


def test_measures_of_a_scripted_episode():
    seen = []
    env = ScriptedEnv([0.2, 0.6, 0.9, 0.96, 1.0], time_limit=20.0)
    episode = run_episode(env, ScriptedExplorer(), seed=1, on_step=lambda info: seen.append(info["time"]))
    assert (episode.time_to_90, episode.time_to_95, episode.time_to_99) == (4.0, 6.0, 8.0)
    assert (episode.distance_to_95, episode.path_length, episode.collisions) == (1.5, 2.0, 2)
    # Trapezoids of 2 s up to 8 s, then 1.0 held for 12 s.
    assert episode.area_under_curve == pytest.approx((0.8 + 1.5 + 1.86 + 1.96 + 12.0) / 20.0)
    assert episode.position_rmse == pytest.approx(np.sqrt((3 * 0.03**2 + 2 * 0.04**2) / 5))
    assert episode.heading_rmse == pytest.approx(0.1)
    assert (episode.success, episode.end_reason, episode.map_iou) == (True, "covered", 0.8)
    assert (episode.duration, episode.time_limit, episode.area_left) == (8.0, 20.0, 0.0)
    assert seen == [0.0, 2.0, 4.0, 6.0, 8.0] == episode.curve.time.tolist()
    assert 0.0 < episode.decision_ms < 50.0


def test_a_mark_that_is_never_reached_is_recorded_as_such():
    episode = run_episode(ScriptedEnv([0.2, 0.5, 0.92], time_limit=4.0), ScriptedExplorer(), seed=1)
    assert (episode.time_to_90, episode.time_to_95, episode.time_to_99) == (4.0, math.inf, math.inf)
    assert (episode.distance_to_95, episode.distance_limit) == (math.inf, 0.5 * 4.0)
    assert (episode.success, episode.end_reason) == (False, "time_limit")
    assert episode.area_left == pytest.approx(4.0)


def test_an_explorer_that_gives_up_ends_the_episode_and_says_why(monkeypatch):
    monkeypatch.setattr(baselines.episode, "map_iou", lambda grid, area, start: 0.3)
    env = ScriptedEnv([0.2, 0.4, 0.5, 0.9, 0.9], time_limit=100.0)
    episode = run_episode(env, ScriptedExplorer(stop_at=3), seed=1)
    assert (episode.end_reason, episode.duration, episode.explored_fraction) == ("no_reachable_frontier", 4.0, 0.5)
    assert (episode.time_to_90, episode.success, episode.map_iou) == (math.inf, False, 0.3)
    assert episode.area_under_curve == pytest.approx((0.6 + 0.9 + 0.5 * 96.0) / 100.0)
    assert episode.area_left == pytest.approx(25.0)


def test_the_explorer_draws_from_the_seed_and_not_as_the_environment_does():
    env, explorer, draws = ScriptedEnv([0.5, 1.0], time_limit=9.0), ScriptedExplorer(), {}
    for seed in (1, 2, 1):
        run_episode(env, explorer, seed)
        assert draws.setdefault(seed, explorer.draw) == explorer.draw
        env_draws = {env.np_random.random(), *(rng.random() for rng in env.np_random.spawn(3))}
        assert explorer.draw not in env_draws
    assert draws[1] != draws[2]


def test_the_loop_ends_with_the_episode_or_the_driver_or_after_max_steps():
    env, seen = ScriptedEnv([0.2, 0.4, 0.5, 0.6, 0.7], time_limit=8.0), []
    answers = iter([np.zeros(2), np.zeros(2), "stuck"])
    ended = run(env, lambda _: next(answers), *env.reset(), lambda info: seen.append(info["time"]))
    assert (ended.info["end_reason"], ended.info["time"], len(ended.decision_times)) == ("stuck", 4.0, 3)
    assert seen == [0.0, 2.0, 4.0]
    # It goes on from where it stopped.
    ended = run(env, lambda _: np.zeros(2), ended.observation, ended.info, max_steps=1)
    assert (ended.info["time"], len(ended.decision_times)) == (6.0, 1)
    ended = run(env, lambda _: np.zeros(2), ended.observation, ended.info)
    assert (ended.info["end_reason"], ended.info["time"]) == ("time_limit", 8.0)
