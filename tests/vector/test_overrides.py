"""Methods that users override act alike in single and in vector environments."""

import contextlib
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.overrides import overridden, public_methods
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.task import Rewards
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarVectorEnv
from tests.rollouts import step_both

REACH = {"task": ReachGoal, "physics": "kinematic", "world": "turtlebot3_world"}
EXPLORE = {**REACH, "task": Explore, "slam": "odometry"}
NAMES = sorted(public_methods(LidarEnv) & vars(LidarEnv).keys())


class CalledError(Exception):
    pass


armed = []


def member(name):
    """Return a method or property that acts as that of `LidarEnv` until it is armed, and then raises `CalledError`."""
    own = vars(LidarEnv)[name]

    def act(self, *args, **kwargs):
        if armed:
            raise CalledError
        return own.__get__(self) if isinstance(own, property) else own(self, *args, **kwargs)

    return property(act) if isinstance(own, property) else act


def subclass(name, **arguments):
    return type("Own", (LidarEnv,), {name: member(name)})(**arguments)


def mixin(name, **arguments):
    return type("Own", (type("Mixin", (), {name: member(name)}), LidarEnv), {})(**arguments)


def own_attribute(name, **arguments):
    env = LidarEnv(**arguments)
    setattr(env, name, partial(member(name), env))
    return env


def run(env, actions):
    """Return whether an armed method is called by a reset, and by which step."""
    seen = []
    armed.clear()
    env.reset(seed=0)
    armed.append(True)
    for action in actions:
        try:
            _, reward, terminated, *_ = env.step(action)
            seen.append((np.squeeze(reward), np.squeeze(terminated)))
        except CalledError:
            seen.append("called")
            break
    armed.clear()
    with contextlib.suppress(Exception):
        env.close()
    return seen


HOWS = [(how, name) for name in NAMES for how in (subclass, mixin)]
HOWS += [(own_attribute, name) for name in NAMES if callable(getattr(LidarEnv, name))]


@pytest.mark.parametrize(("how", "name"), HOWS)
def test_each_public_method_is_called_as_in_a_single_environment(how, name):
    make, action = partial(how, name), np.full(2, 0.5, dtype=np.float32)
    single = run(make(**REACH), [action] * 2)
    assert run(LidarVectorEnv(make, 1, num_workers=1, **REACH), [action[None]] * 2) == single


def test_methods_of_a_step_are_among_those_that_are_called():
    action, called = np.full(2, 0.5, dtype=np.float32), set()
    for name in NAMES:
        if "called" in run(subclass(name, **REACH), [action] * 2):
            called.add(name)
    assert called >= {"step", "apply", "commands", "observe", "write_part", "outcome"}
    assert called >= {"reward_terms", "judge", "info", "is_over"}


class Mine(LidarEnv):
    """Overrides methods without the optional parameters, and adds one."""

    def observe(self):
        return {name: 0.5 * value for name, value in super().observe().items()}

    def outcome(self):
        reward, *rest = super().outcome()
        return (reward + self.bonus(), *rest)

    def reset(self, **arguments):
        observation, info = super().reset(**arguments)
        return observation, info | {"bonus": self.bonus()}

    def bonus(self):
        return 7.0


class Counted(LidarEnv):
    def step(self, action):
        observation, reward, *rest = super().step(action)
        return (observation, reward + 7.0, *rest)


class Repeating(Robot):
    def locate(self, flags):
        super().locate(flags)
        self.action = (0.25, -0.25)


class WithRobot(LidarEnv):
    def __init__(self, **arguments):
        super().__init__(**arguments)
        self.robots = [Repeating(self.robot_params, self.control_period, self.task.make_estimator())]


class Doubled(Rewards):
    def checked_total(self, terms):
        return 2.0 * super().checked_total(terms)


def shadowing(get, name, change, kind=LidarEnv, **arguments):
    """Return an environment with an object whose method `name` an attribute replaces."""
    env = kind(**arguments)
    thing = get(env)
    setattr(thing, name, partial(change, getattr(thing, name)))
    return env


def halved(method, *args):
    return {name: 0.5 * value for name, value in method(*args).items()}


def blackened(method, robot, out):
    out[...] = 0.25


OWN = {
    "methods without optional parameters": (Mine, REACH),
    "a step": (Counted, REACH),
    "a robot": (WithRobot, EXPLORE),
    "a total": (LidarEnv, {**REACH, "reward": Doubled}),
    "quantities of a task": (partial(shadowing, lambda env: env.task, "quantities", halved), REACH),
    "quantities between scans": (partial(shadowing, lambda env: env.task, "quantities", halved), EXPLORE),
    "terms of a reward": (partial(shadowing, lambda env: env.task.rewards, "terms", halved), REACH),
    "a part": (partial(shadowing, lambda env: env.parts["motion"], "write", blackened), REACH),
    "a part of the second one": (partial(shadowing, lambda env: env.parts["goal"], "write", blackened), REACH),
}


@pytest.mark.parametrize("case", OWN)
def test_results_of_own_methods_equal_those_of_single_environments(case):
    make, arguments = OWN[case]
    theirs = SyncVectorEnv([partial(make, **arguments)] * 2, autoreset_mode=AutoresetMode.NEXT_STEP)
    ours = LidarVectorEnv(make, 2, num_workers=1, **arguments)
    with contextlib.closing(ours), contextlib.closing(theirs):
        for _ in step_both(ours, theirs, np.full((12, 2, 2), 0.5, dtype=np.float32)):
            pass


def test_new_methods_and_other_spaces_leave_an_environment_fast():
    class Larger(LidarEnv):
        uses_ground_truth = True

        def __init__(self, **arguments):
            super().__init__(**arguments)
            self.bonus = 2.0

        def reward_of_mine(self):
            return self.bonus

        def _reward(self):
            return 0.0

    vector = LidarVectorEnv(Larger, 2, num_workers=1, **REACH)
    vector.reset(seed=0)
    assert vector.get_attr("why_not_fused") == ("", "")
    assert vector.call("reward_of_mine") == (2.0, 2.0)
    vector.set_attr("reward_terms", lambda quantities: {"time": 5.0})
    assert vector.get_attr("why_not_fused") == ("Larger overrides reward_terms",) * 2
    assert vector.step(np.zeros((2, 2)))[1].tolist() == [5.0, 5.0]
    vector.close()


def test_a_step_limit_truncates_environments_with_own_methods():
    vector = LidarVectorEnv(Counted, 1, num_workers=1, max_episode_steps=2, **REACH)
    vector.reset(seed=0)
    ends = [np.ravel(vector.step(np.zeros((1, 2)))[2:4]).tolist() for _ in range(2)]
    assert ends == [[False, False], [False, True]]
    vector.close()


@pytest.mark.parametrize("id", ["ReachGoal", "ExploreFrontiers", "ExploreTeamFrontiers", "ExploreFrontiersAbstract"])
def test_environments_of_the_package_override_nothing(id):
    env = gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic").unwrapped
    env.reset(seed=0)
    assert overridden(env) == []
    env.close()
