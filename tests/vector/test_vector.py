import contextlib
import itertools
import os
import time
from dataclasses import dataclass
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import ClipAction, FlattenObservation, NormalizeReward, TimeLimit

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.observations import Motion
from lidarnaut.envs.task import SHARED_QUANTITIES
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarEnvs, LidarVectorEnv
from tests.rollouts import assert_same, step_both
from tests.test_core import Beacon, Nailed
from tests.vector.pairs import both

explore_envs = partial(LidarEnvs, task=Explore)
QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "control_hz": 5.0, "time_limit": 3.0}


class Travelled:
    def reset(self, robot):
        self.count = 0

    def space(self, robot):
        return spaces.Box(-np.inf, np.inf, (3,), np.float32)

    def write(self, robot, out):
        self.count += 1
        out[...] = self.count, robot.belief.pose.x, robot.belief.pose.y


class Faster(Motion):
    def write(self, robot, out):
        super().write(robot, out)
        out[0] *= 0.5


@dataclass(kw_only=True, eq=False)
class Counting(Explore):
    """Reports every fifth control period."""

    def reset(self, *args):
        self.count = 0
        return super().reset(*args)

    def update(self, simulator, robots, period):
        super().update(simulator, robots, period)
        self.count += 1

    def quantities(self):
        return super().quantities() | {"time": 1.0 + self.count}

    def metrics(self):
        fifth = {"fifth": self.count} if self.count % 5 == 0 and self.count else {}
        return super().metrics() | {"count": self.count} | fifth


@dataclass(kw_only=True, eq=False)
class Halved(ReachGoal):
    def quantities(self):
        return {name: 0.5 * value for name, value in super().quantities().items()}


class Braked(LidarEnv):
    def commands(self, action):
        return super().commands(action) * (0.5, 1.0)


WAREHOUSE = {"world": "tugbot_warehouse", "robot": "tugbot", "slam": "odometry", "time_limit": 3.0}
LIDAR = {"lidar.noise_std": (0.005, 0.03), "lidar.dropout": (0.0, 0.1), "lidar.mount.yaw": (-0.05, 0.05)}
RANGES = {**LIDAR, "drive.wheel_radius": (0.031, 0.035), "drive.slip_std": (0.0, 0.01), "max_v": (0.15, 0.22)}
FRICTION = {**RANGES, "drive.friction": (0.4, 1.0)}
TRACKS = ("scan", "map_near", "motion", "tracks")
CROWD = {**QUICK, "world_size": (9.0, 9.0), "people": (2, 4), "contact": "costs", "cost": True}
REACH_PARTS = ("scan", "scan_history", "goal", "map_near")
CASES = {
    "rooms": ("Explore", QUICK),
    "movers": ("Explore", {"world": "turtlebot3_stage_4", "slam": "truth", "time_limit": 3.0, "observations": TRACKS}),
    "growing map": ("Explore", WAREHOUSE),
    "key scans": ("Explore", {**QUICK, "slam": "hector", "time_limit": 8.0}),
    "gmapping": ("Explore", {**QUICK, "slam": "gmapping"}),
    "graph": ("Explore", {**QUICK, "slam": "graph?preset=cartographer,max_range=1.5"}),
    "bullet": ("Explore", {**QUICK, "physics": "bullet", "randomize": FRICTION}),
    "frontiers": ("ExploreFrontiers", {**QUICK, "time_limit": 15.0}),
    "abstract": ("ExploreFrontiersAbstract", {**QUICK, "time_limit": 12.0, "randomize": LIDAR}),
    "team": ("ExploreTeam", {**QUICK, "num_robots": 2, "reward": dict.fromkeys(SHARED_QUANTITIES, 0.1)}),
    "team frontiers": ("ExploreTeamFrontiers", {**QUICK, "time_limit": 8.0, "num_robots": 2}),
    "navigate": ("Navigate", QUICK),
    "dock": ("Dock", {"start": (13.0, -10.3, 0.5), "time_limit": 1.5}),
    "sweep": ("Sweep", QUICK),
    "reach": ("ReachGoal", QUICK),
    "reach, costs": ("ReachGoal", {**QUICK, "contact": "costs", "robot": "jackal", "reward": {"progress": 2.0}}),
    "reach, people": ("ReachGoal", {**CROWD, "reward": "tests.tasks.test_rewards:Smooth", "time_limit": 6.0}),
    "reach, carrot": ("ReachGoal", {**QUICK, "observations": {"carrot": {"path": "shortest"}, "goal": None}}),
    "reach, own task": ("ReachGoal", {**QUICK, "task": Halved}),
    "reach, own parts": ("ReachGoal", {**QUICK, "observations": {"goal": None, "mine": Travelled}}),
    "reach, sensor": ("ReachGoal", {**QUICK, "sensors": [Beacon()], "observations": ("scan_history", "beacon")}),
    "reach, monitor": ("ReachGoal", {**QUICK, "contact": "costs", "collision_monitor": True}),
    "reach with a map": ("ReachGoal", {**QUICK, "slam": "hector", "contact": "costs", "observations": REACH_PARTS}),
    "track": ("Track", {"time_limit": 1.5, "map_resolution": 0.1, "path": ((4.1, 3.2), (8.1, 3.2))}),
    "randomized": ("Explore", {**QUICK, "slam": "hector", "randomize": RANGES}),
    "randomized team": ("ExploreTeam", {**QUICK, "time_limit": 1.0, "randomize": RANGES}),
    "return home": ("Explore", {**QUICK, "time_limit": 5.0, "return_home": True, "target_coverage": 0.6}),
    "part": ("Explore", {**QUICK, "observations": {"scan": None, "map_near": None, "mine": Travelled}}),
    "overwritten part": ("Explore", {**QUICK, "observations": {"motion": Faster}}),
    "plan": ("Explore", {**QUICK, "observations": ("motion", "plan")}),
    "reward": ("Explore", {**QUICK, "reward": "tests.test_core:Hurry"}),
    "task": ("Explore", {**QUICK, "task": Counting}),
    "estimator": ("Explore", {**QUICK, "slam": "tests.test_core:Nailed"}),
    "sensor": ("Explore", {**QUICK, "sensors": [Beacon()], "observations": ("scan", "beacon")}),
    "flat": ("Explore", QUICK, FlattenObservation),
    "clipped": ("Explore", QUICK, ClipAction),
    "limit and reward": ("Explore", QUICK, partial(TimeLimit, max_episode_steps=7), NormalizeReward),
}
"""Ids, arguments and wrappers of each sub-environment."""


def actions_of(env, steps, seed=0):
    env.action_space.seed(seed)
    for _ in range(steps):
        actions = env.action_space.sample()
        yield np.abs(actions) if actions.dtype == np.float32 else actions


MODES = itertools.cycle((AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP))


@pytest.mark.parametrize(("case", "mode"), [*zip(CASES, MODES, strict=False), ("rooms", AutoresetMode.SAME_STEP)])
def test_sub_environments_equal_single_ones_bit_for_bit(case, mode):
    name, arguments, *wrappers = CASES[case]
    arguments = {"physics": "kinematic", **arguments}
    ended, drawn = 0, set()
    with both(f"lidarnaut/{name}-v0", mode, 2, arguments, wrappers) as (ours, theirs):
        assert ours.single_observation_space == theirs.single_observation_space
        assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
        for (_, terminated, truncated), info in step_both(ours, theirs, actions_of(ours, 44)):
            ended += np.count_nonzero(terminated | truncated)
            drawn |= set(info["randomized"]["lidar.noise_std"].tolist()) if "randomized" in info else set()
        is_fused = case not in ("bullet", "abstract", "team frontiers")
        assert [not reason for reason in ours.get_attr("why_not_fused")] == [is_fused] * 3
    assert ended >= 3
    assert len(drawn) >= 6 or "randomize" not in arguments


@pytest.mark.parametrize("asks_always", [True, False])
@pytest.mark.parametrize(("task", "settings"), [(Explore, {}), (ReachGoal, {"robot": "jackal", "contact": "costs"})])
def test_objects_of_sub_environments_are_up_to_date_whenever_they_are_asked_for(
    task, settings, asks_always, monkeypatch
):
    monkeypatch.setattr("lidarnaut.envs.period.MOST_POSITIONS", 5)
    settings = {**QUICK, "time_limit": 20.0, **settings}
    ours, theirs = LidarEnvs(1, task=task, **settings), LidarEnv(task, physics="kinematic", **settings)
    ours.reset(seed=3)
    theirs.reset(seed=3)
    for k, action in enumerate(actions_of(ours, 40)):
        ours.step(action)
        theirs.step(action[0])
        if not asks_always and k < 39:  # kernels note the trails
            continue
        (robots,), (truths,), (task,) = ours.get_attr("robots"), ours.get_attr("truths"), ours.get_attr("task")
        robot, truth, other = robots[0], truths[0], theirs.robots[0]
        assert robot.belief.pose == other.belief.pose
        assert robot.belief.update.window == other.belief.update.window
        assert task.quantities() == theirs.task.quantities()
        assert (robot.twist, robot.action, robot.collisions) == (other.twist, other.action, other.collisions)
        assert (truth.state, truth.path_length) == (theirs.truths[0].state, theirs.truths[0].path_length)
        np.testing.assert_array_equal(robot.reading.ranges, other.reading.ranges)
        np.testing.assert_array_equal(robot.trail.positions, other.trail.positions)
        np.testing.assert_array_equal(truth.trail.positions, theirs.truths[0].trail.positions)
    assert len(truth.trail.positions) > 5
    ours.close()


@pytest.mark.parametrize(
    ("kind", "arguments", "why"),
    [
        (partial(LidarEnv, Explore), {}, ""),
        (partial(Braked, Explore), {}, "Braked overrides commands"),
        (partial(LidarEnv, Explore), {"physics": "bullet"}, "BulletSimulator steps in Python"),
        (ExploreFrontiersEnv, {}, ""),
        (ExploreFrontiersEnv, {"slam": Nailed}, "Nailed processes every scan"),
    ],
)
def test_environments_say_whether_they_are_fused_and_why_not(kind, arguments, why):
    env = kind(**{**QUICK, "physics": "kinematic", **arguments})
    env.reset(seed=0)
    assert env.why_not_fused == why
    env.close()


@pytest.mark.parametrize("how", [{"num_workers": 0}, {"num_workers": 3}, {"num_workers": 2, "context": "forkserver"}])
def test_the_number_of_workers_and_how_they_start_change_nothing(how):
    envs = [explore_envs(3, **arguments, **QUICK) for arguments in (how, {"num_workers": 2})]
    for _ in step_both(*envs, actions_of(envs[0], 20)):
        pass
    for env in envs:
        env.close()


def test_make_vec_gives_shards_of_every_id():
    specs = [spec for id, spec in gymnasium.registry.items() if id.startswith("lidarnaut/")]
    assert all(spec.vector_entry_point for spec in specs)
    env = gymnasium.make_vec("lidarnaut/ExploreRooms-v0", num_envs=4, world_size=(6.0, 6.0), control_hz=5.0)
    assert isinstance(env.unwrapped, LidarVectorEnv)
    assert env.spec.id == "lidarnaut/ExploreRooms-v0"
    assert env.observation_space["map_near"].shape == (4, 3, 40, 40)
    env.close()


def test_a_step_in_two_halves_is_a_step():
    whole, halves = (LidarVectorEnv(LidarEnv, 3, task=ReachGoal, num_workers=2) for _ in range(2))
    with contextlib.closing(whole), contextlib.closing(halves):
        with pytest.raises(gymnasium.error.NoAsyncCallError, match="call step_async before step_wait"):
            halves.step_wait()
        for env in (whole, halves):
            env.reset(seed=0)
        for actions in np.random.default_rng(0).uniform(-1, 1, (5, 3, 2)).astype(np.float32):
            halves.step_async(actions)
            for one, other in zip(whole.step(actions), halves.step_wait(), strict=True):
                assert_same(other, one)
            with pytest.raises(gymnasium.error.NoAsyncCallError):
                halves.step_wait()


def test_observations_are_fresh_and_a_reset_repeats():
    env = explore_envs(2, **QUICK)
    first, _ = env.reset(seed=3)
    kept = {key: value.copy() for key, value in first.items()}
    for action in actions_of(env, 25):
        env.step(action)
    assert_same(first, kept)
    assert_same(env.reset(seed=3)[0], kept)
    assert_same(env.reset(seed=np.array([3, 4]))[0], kept)
    env.close()


@pytest.mark.parametrize("how", [{"num_workers": 0}, {"num_workers": 2, "env_wrappers": [FlattenObservation]}])
def test_render_call_and_attributes_reach_every_sub_environment(how):
    env = explore_envs(3, render_mode="rgb_array", **how, **QUICK)
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 3
    assert not np.array_equal(frames[0], frames[1])
    for given, seen in ((3.0, (3.0, 3.0, 3.0)), ([1.0, 2.0, 3.0], (1.0, 2.0, 3.0)), (9.0, (9.0, 9.0, 9.0))):
        env.set_attr("time_limit", given)
        assert env.get_attr("time_limit") == env.call("get_wrapper_attr", "time_limit") == seen
    with pytest.raises(ValueError, match="values"):
        env.set_attr("time_limit", [1.0, 2.0])
    env.close()


def test_actions_can_be_clipped():
    clipped, inside = explore_envs(2, clip_actions=True, **QUICK), explore_envs(2, **QUICK)
    actions = 3.0 * np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2, 2)).astype(np.float32)
    assert_same(clipped.reset(seed=0)[0], inside.reset(seed=0)[0])
    for action in actions:
        assert_same(clipped.step(action)[0], inside.step(action.clip(-1.0, 1.0))[0])
    clipped.close()
    inside.close()


class SlowlyPrepared(LidarEnv):
    is_preparing = False

    def prepare(self):
        type(self).is_preparing = True
        time.sleep(0.5)
        type(self).is_preparing = False


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_no_process_is_forked_while_an_episode_is_being_prepared():
    env = LidarVectorEnv(SlowlyPrepared, 1, task=Explore, num_workers=1, physics="kinematic", **QUICK)
    env.reset(seed=0)
    deadline = time.monotonic() + 5.0
    while not SlowlyPrepared.is_preparing and time.monotonic() < deadline:
        time.sleep(0.01)
    assert SlowlyPrepared.is_preparing
    if (child := os.fork()) == 0:
        os._exit(int(SlowlyPrepared.is_preparing))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    env.close()
