"""Vector environments with parts, rewards, tasks, estimators, sensors and wrappers of the user's own."""

from dataclasses import dataclass, replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import ClipAction, FlattenObservation, NormalizeReward, TimeLimit

from envs.core import LidarEnv
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.observations import Motion
from envs.slam import KnownPoses, load_params
from envs.task import Rewards
from envs.tasks.explore import Explore
from envs.vector import LidarEnvs, make_vec
from tests.side_by_side import step_both
from tests.test_vector import QUICK, actions_of


class Travelled:
    """Counts the steps of the episode, and shows the estimated position."""

    def reset(self, robot):
        self.count = 0

    def space(self, robot):
        return spaces.Box(-np.inf, np.inf, (3,), np.float32)

    def write(self, robot, out):
        self.count += 1
        out[...] = self.count, robot.belief.pose.x, robot.belief.pose.y


class Faster(Motion):
    """A part of the package with a `write` of the user's own."""

    def write(self, robot, out):
        super().write(robot, out)
        out[0] *= 0.5


class Squared(Rewards):
    """Terms that are not linear in the quantities."""

    def terms(self, quantities):
        return {name: weight * quantities[name] ** 2 for name, weight in self.weights.items()}


@dataclass(kw_only=True, eq=False)
class Counting(Explore):
    """Counts control periods, and tells of every fifth."""

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


class EveryScan(KnownPoses):
    """A SLAM with an `update` of its own."""

    def __init__(self, lidar, resolution):
        super().__init__(lidar, replace(load_params("default"), resolution=resolution))

    def update(self, reading, motion):
        return super().update(reading, motion)


class Clock:
    """A sensor."""

    name, shape = "clock", (1,)

    def reset(self, world, rng):
        self.rng = rng

    def measure(self, simulator, robot):
        return np.array([simulator.states[robot].pose.x + self.rng.random()])


CASES = {
    "part": {"observations": {"scan": None, "map_near": None, "mine": Travelled}},
    "overwritten part": {"observations": {"motion": Faster}},
    "plan": {"observations": ("motion", "plan")},
    "reward": {"reward": Squared},
    "task": {"task": Counting},
    "estimator": {"slam": EveryScan},
    "sensor": {"sensors": [Clock()], "observations": ("scan", "clock")},
    "return home": {"return_home": True, "target_coverage": 0.6},
}


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("case", CASES)
def test_sub_environments_with_own_things_are_fused_and_equal_single_ones(case, mode):
    arguments = {"task": Explore, **QUICK, "time_limit": 5.0, **CASES[case]}
    ours = LidarEnvs(3, num_workers=1, autoreset_mode=mode, **arguments)
    theirs = SyncVectorEnv([lambda: LidarEnv(**arguments, physics="kinematic")] * 3, autoreset_mode=mode)
    for _ in step_both(ours, theirs, actions_of(ours, 56)):
        pass
    assert ours.get_attr("is_fused") == (True,) * 3
    assert ours._shard._batch is not None
    ours.close()


def test_objects_of_sub_environments_are_up_to_date_whenever_they_are_asked_for():
    ours, theirs = LidarEnvs(1, task=Explore, **QUICK), LidarEnv(Explore, physics="kinematic", **QUICK)
    ours.reset(seed=3)
    theirs.reset(seed=3)
    for action in actions_of(ours, 9):
        ours.step(action)
        theirs.step(action[0])
        (robots,), (truths,), (task,) = ours.get_attr("robots"), ours.get_attr("truths"), ours.get_attr("task")
        robot, truth, other = robots[0], truths[0], theirs.robots[0]
        assert robot.belief.pose == other.belief.pose
        assert robot.belief.update.window == other.belief.update.window
        assert task.quantities() == theirs.task.quantities()
        assert (robot.twist, robot.action, robot.collisions) == (other.twist, other.action, other.collisions)
        assert (truth.state, truth.path_length) == (theirs.truths[0].state, theirs.truths[0].path_length)
        np.testing.assert_array_equal(robot.reading.ranges, other.reading.ranges)
        np.testing.assert_array_equal(robot.trail.positions, other.trail.positions)
    ours.close()


class Braked(LidarEnv):
    """Has twists of its own."""

    def twists(self, action):
        return [twist._replace(v=0.5 * twist.v) for twist in super().twists(action)]


def test_environments_say_whether_they_are_fused_and_why_not():
    env = LidarEnv(Explore, physics="kinematic", **QUICK)
    assert (env.is_fused, env.why_not_fused) == (True, "")
    assert Braked(Explore, physics="kinematic", **QUICK).why_not_fused == "Braked has twists of its own"
    decisions = ExploreFrontiersEnv(physics="kinematic", **QUICK)
    decisions.reset(seed=0)
    assert (decisions.is_fused, decisions.why_not_fused) == (True, "")
    decisions = ExploreFrontiersEnv(physics="kinematic", slam=EveryScan, **QUICK)
    decisions.reset(seed=0)
    assert (decisions.is_fused, decisions.why_not_fused) == (False, "EveryScan processes every scan")
    pytest.importorskip("pybullet")
    assert LidarEnv(Explore, physics="bullet", **QUICK).why_not_fused == "BulletSimulator steps in Python"


WRAPPERS = {
    "flat": [FlattenObservation],
    "clipped": [ClipAction],
    "limit and reward": [partial(TimeLimit, max_episode_steps=7), NormalizeReward],
}


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("case", WRAPPERS)
def test_sub_environments_may_be_wrapped(case, mode):
    wrappers, arguments = WRAPPERS[case], {"physics": "kinematic", **QUICK}

    def single():
        env = gymnasium.make("lidarnaut/Explore-v0", **arguments).unwrapped
        for wrapper in wrappers:
            env = wrapper(env)
        return env

    ours = make_vec("lidarnaut/Explore-v0", 3, wrappers=wrappers, num_workers=2, autoreset_mode=mode, **arguments)
    theirs = SyncVectorEnv([single] * 3, autoreset_mode=mode)
    assert ours.single_observation_space == theirs.single_observation_space
    scale = 3.0 if case == "clipped" else 1.0
    steps = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3, 2)).astype(np.float32)
    for _ in step_both(ours, theirs, scale * steps):
        pass
    assert ours.get_attr("is_fused") == (True,) * 3
    ours.set_attr("time_limit", 9.0)
    assert ours.get_attr("time_limit") == (9.0,) * 3
    ours.close()


def test_steps_of_wrapped_sub_environments_are_counted():
    env = LidarEnvs(2, task=Explore, max_episode_steps=4, env_wrappers=[FlattenObservation], **QUICK)
    env.reset(seed=0)
    ends = [env.step(action)[3].all() for action in actions_of(env, 4)]
    assert ends == [False, False, False, True]
    env.close()
