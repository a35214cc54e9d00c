import math
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import begin_episode, decide_with, run, run_episode
from lidarnaut.baselines.policy import OnePerRobot
from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.geometry import ORIGIN
from lidarnaut.envs.navigation.controllers.local_planner import NO_TRACKS
from lidarnaut.envs.rendering.overlay import Overlay
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.explore import Explore


class ScriptedEnv(LidarEnv):
    """Each step takes 2 s and 0.5 m, with a fraction from a list, and position errors of 3 and 4 cm."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    robot = robot_params = SimpleNamespace(max_v=0.5, max_w=1.0)
    control_period = 2.0
    reading, belief = None, SimpleNamespace(pose=ORIGIN, people=NO_TRACKS)

    def __init__(self, fractions, time_limit, target=0.99):
        self.fractions, self.time_limit, self.target = fractions, time_limit, target
        self.overlay = Overlay(1)
        self.task = Explore()

    def final_metrics(self):
        return {"map_iou": 0.8, "area_left": 50.0 * (1.0 - self.fractions[self.step_number])}

    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        self.step_number = 0
        return {}, self._info()

    def step(self, action):
        self.step_number += 1
        terminated = self.fractions[self.step_number] >= self.target
        truncated = not terminated and 2.0 * self.step_number >= self.time_limit
        info = self._info()
        if terminated or truncated:
            info |= self.final_metrics() | {"end_reason": "covered" if terminated else "time_limit"}
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
    plan = np.zeros((1, 2))

    def __init__(self, stop_at=10**9):
        self.stop_at = stop_at

    def reset(self, robot, control_period, rng):
        self.end_reason = None
        self.decisions, self.period = 0, control_period
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
    assert seen == [0.0, 2.0, 4.0, 6.0, 8.0] == episode.history.of("time").tolist()
    assert 0.0 < episode.decision_ms < 50.0


def test_an_episode_that_ends_early_says_why_and_which_marks_were_never_reached():
    episode = run_episode(ScriptedEnv([0.2, 0.5, 0.92], time_limit=4.0), ScriptedExplorer(), seed=1)
    assert (episode.time_to_90, episode.time_to_95, episode.distance_to_95) == (4.0, math.inf, math.inf)
    assert (episode.success, episode.end_reason, episode.distance_limit) == (False, "time_limit", 0.5 * 4.0)
    episode = run_episode(ScriptedEnv([0.2, 0.4, 0.5, 0.9], time_limit=100.0), ScriptedExplorer(stop_at=3), seed=1)
    assert (episode.end_reason, episode.duration, episode.explored_fraction) == ("no_reachable_frontier", 4.0, 0.5)
    assert (episode.time_to_90, episode.success, episode.map_iou) == (math.inf, False, 0.8)
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
    ended = run(env, lambda _: np.zeros(2), ended.observation, ended.info, max_steps=1)
    assert (ended.info["time"], len(ended.decision_times)) == (6.0, 1)
    ended = run(env, lambda _: np.zeros(2), ended.observation, ended.info)
    assert (ended.info["end_reason"], ended.info["time"]) == ("time_limit", 8.0)


@pytest.mark.parametrize(
    ("id", "arguments", "names"),
    [
        ("Explore", {"world": "pimouse_arena"}, ("nearest", "random", "oracle", "wall_follower")),
        ("ExploreFrontiers", {"world": "pimouse_arena"}, ("nearest", "random", "gain_over_cost")),
        ("ExploreTeam", {"world": "turtlebot3_world"}, ("rrt_team", "random", "wall_follower")),
        ("Navigate", {"localizer": "truth"}, ("pursuit", "dwb", "random", "wall_follower")),
    ],
)
def test_classic_policies_do_the_tasks_that_they_are_offered_for(id, arguments, names):
    env = gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic", time_limit=4.0, **arguments)
    env.reset(seed=0)
    makers = policies_for(env)
    assert set(names) <= set(makers)
    for name in names:
        episode = run_episode(env, makers[name](), 0)
        assert episode.end_reason in ("covered", "reached", "time_limit"), name
        assert episode.values.keys() >= {"path_length", "success"}
        assert episode.duration == episode.history.of("time")[-1] <= 4.0 + 4.0
    assert "tour" not in makers or "Explore" in id
    env.close()


def test_actions_are_repeated_where_a_policy_decides_less_often():
    explorer = ScriptedExplorer()
    explorer.control_hz = 0.25  # every 4 s; the environment steps every 2 s
    run_episode(ScriptedEnv([0.2] * 6, time_limit=10.0), explorer, seed=1)
    assert (explorer.decisions, explorer.period) == (3, 4.0)
    explorer.control_hz = 0.3
    with pytest.warns(UserWarning, match="has control_hz 0.3, but decides every 4 s here"):
        begin_episode(ScriptedEnv([0.2, 0.2], time_limit=10.0), explorer, 1, np.random.default_rng(0))


def test_who_drives_one_robot_says_how_it_drives_a_team():
    env = gymnasium.make("lidarnaut/ExploreTeam-v0", physics="kinematic", world="turtlebot3_world")
    with pytest.raises(ValueError, match=r"ScriptedExplorer drives one robot.*OnePerRobot\(ScriptedExplorer\(\)\)"):
        decide_with(ScriptedExplorer(), env)
    decide_with(OnePerRobot(ScriptedExplorer()), env)
    env.close()


class Patience(gymnasium.Wrapper):
    """Ends episodes after 8 steps by `flag`."""

    def __init__(self, env, flag):
        super().__init__(env)
        self.flag = flag

    def reset(self, **arguments):
        self.count = 0
        return super().reset(**arguments)

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        self.count += 1
        flags = {"terminated": False, "truncated": False} | {self.flag: self.count == 8}
        return observation, reward, *flags.values(), info


SHORT = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "slam": "odometry"}


@pytest.mark.parametrize(
    ("id", "arguments", "flag", "reason"),
    [
        ("Explore", {"max_episode_steps": 8}, None, "time_limit"),
        ("Explore", {"max_episode_steps": 8, "fixed_info": True}, None, "time_limit"),
        ("Explore", {}, "truncated", "time_limit"),
        ("Explore", {}, "terminated", "terminated"),
        ("ReachGoal", {"max_episode_steps": 8}, None, "time_limit"),
    ],
)
def test_episodes_that_wrappers_end_are_measured_at_that_moment(id, arguments, flag, reason):
    env, seen = gymnasium.make(f"lidarnaut/{id}-v0", **SHORT, **arguments), []
    env = env if flag is None else Patience(env, flag)
    policy = policies_for(env)["random"]()
    episode = run_episode(env, policy, 0, seen.append)
    assert (episode.end_reason, len(episode.decision_times)) == (reason, 8)
    assert episode.duration == pytest.approx(0.8)
    inner = env.unwrapped.final_metrics()
    assert inner.items() <= seen[-1].items()
    assert all(getattr(episode, name) == value for name, value in inner.items() if name in episode.values)


class Vanishing(Explore):
    def metrics(self):
        count = len(getattr(self, "_seen", ()))
        self._seen = [0.0] * (count + 1)
        return super().metrics() | {"seen": self._seen} | ({"early": 1.0} if count < 3 else {})


def test_entries_of_info_may_vanish_and_change_their_size():
    env = LidarEnv(Vanishing, time_limit=1.0, **SHORT)
    history = run_episode(env, policies_for(env)["random"](), 0).history
    assert "seen" not in history.samples
    np.testing.assert_array_equal(history.samples["early"], [1.0] * 3 + [math.nan] * 8)


@pytest.mark.parametrize(
    ("id", "name", "num_trees"),
    [
        ("Explore-v0", "nearest", 0),
        ("Explore-v0", "rrt", 2),
        ("ExploreTeam-v0", "rrt_team", 3),
        ("ExploreTeam-v0", "auction", 0),
        ("ExploreFrontiers-v0", "nearest", 0),
        ("ExploreTeamFrontiers-v0", "nearest", 0),
        ("Explore-v0", "wall_follower", None),
    ],
)
def test_markers_of_policies_are_shown(id, name, num_trees):
    arguments = {"world": "turtlebot3_house", "physics": "kinematic", "slam": "truth", "time_limit": 8.0}
    env = gymnasium.make(f"lidarnaut/{id}", **arguments)
    env.reset(seed=0)
    inner = lidar_env_of(env)
    run_episode(env, policies_for(env)[name](), 0)
    markers, scene = inner.overlay.markers(), inner.scene()
    if num_trees is None:
        assert markers is None
        return
    grid = inner.belief.grid
    assert len(markers.clusters) > 2
    assert 1 <= len(markers.chosen) <= inner.task.num_robots
    assert len(markers.trees) == num_trees
    ends = [edges.reshape(-1, 2) for edges in markers.trees]
    for points in (markers.clusters, markers.chosen, markers.points, *ends):
        assert grid.contains(grid.cells(points)).all()
    if num_trees == 0:
        gaps = np.hypot(*np.moveaxis(markers.clusters[:, None] - markers.chosen[None], -1, 0)).min(axis=0)
        assert gaps.min() < 1.0
    assert all((grid.data[tuple(grid.cells(points).T)] >= 0).all() for points in ends), "trees stay in known space"
    assert scene.markers.clusters.tolist() == markers.clusters.tolist()
    assert all(peer.markers is None for peer in scene.peers)
    env.reset(seed=1)
    assert (inner.overlay.markers is None) == (id in ("Explore-v0", "ExploreTeam-v0")), "of this episode only"
