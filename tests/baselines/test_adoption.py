import copy
import functools
import pickle
from dataclasses import dataclass
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import lidarnaut  # noqa: F401
from lidarnaut.baselines import NearestExplorer
from lidarnaut.baselines.adoption import adopt
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.policy import Explorer, ObservationPolicy, OnePerRobot, PrivilegedPolicy, marked
from lidarnaut.driver import Driver
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.player import EpisodeRecorder
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.explore import Explore

BOX = spaces.Box(-1.0, 1.0, (2,), np.float32)
AHEAD = Twist(0.1, 0.0)
QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "time_limit": 0.5}


class Duck:
    """Explorer without a base class, with attributes of its own that have the names of the interface."""

    def __init__(self):
        self.robot, self.calls = "my arm", 0

    def act(self, reading, belief):
        self.calls += 1
        return AHEAD


class Slotted:
    __slots__ = ("calls",)

    def __init__(self):
        self.calls = 0

    def act(self, reading, belief):
        self.calls += 1
        return AHEAD


@dataclass(frozen=True)
class Frozen:
    speed: float = 0.1

    def act(self, reading, belief):
        return Twist(self.speed, 0.0)


@dataclass(frozen=True)
class FrozenExplorer(Explorer):
    speed: float = 0.1

    def act(self, reading, belief):
        return Twist(self.speed * (self.control_period > 0), 0.0)


class Called:
    def __call__(self, observation=None):
        return observation["motion"][:2] * 0.0 + 3.0


class Predicting:
    """Model with another kind of `reset`."""

    def reset(self, seed=None):
        raise AssertionError

    def predict(self, observation, deterministic=False):
        return np.array([0.5, 0.0]), None


class Sealed(type):
    """Metaclass that allows no further subclass."""

    def __new__(cls, name, bases, members):
        if bases:
            raise TypeError("no subclass")
        return super().__new__(cls, name, bases, members)


class NoSubclass(metaclass=Sealed):
    def act(self, reading, belief):
        return AHEAD


def ahead(observation=None):
    return np.array([0.3 if observation["motion"] is not None else 0.0, 0.0])


def steered(observation, gain):
    return np.array([gain, 0.0])


def act(reading, belief):
    return AHEAD


OBJECTS = {
    "attributes": Duck,
    "slots": Slotted,
    "frozen": Frozen,
    "frozen explorer": FrozenExplorer,
    "called": Called,
    "model": Predicting,
    "sealed": NoSubclass,
    "namespace": lambda: SimpleNamespace(act=act),
    "function": lambda: ahead,
    "partial": lambda: functools.partial(steered, gain=0.2),
    "method": lambda: Called().__call__,
}


def state(value):
    values = {name: getattr(value, name) for name in ("robot", "speed") if hasattr(value, name)}
    return type(value), values, set(getattr(value, "__dict__", ()))


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("id", [None, "lidarnaut/Explore-v0"])
def test_driver_and_episodes_take_policies_without_a_base_class_and_leave_them_alone(name, id):
    value = OBJECTS[name]()
    before = state(value)
    driver = Driver(value, "turtlebot3_burger", id=id, slam="odometry")
    for k in range(4):
        driver.odometry((0.0, 0.0, 0.0), 0.1 * k)
        driver.scan(np.full(360, 1.0), 0.1 * k)
        command = driver.command(0.1 * k)
    assert command.v > 0.0
    with LidarEnv(Explore, **QUICK) as env, EpisodeRecorder(env, value) as recorder:
        assert run_episode(env, value, 0).path_length > 0.02
        assert recorder.recording() is not None
    if name != "frozen explorer":  # a subclass stores the arguments of `reset`
        assert state(value) == before
    if hasattr(value, "calls"):
        assert value.calls > 5


@pytest.mark.parametrize("name", ["attributes", "slots", "frozen", "called", "model", "sealed", "function", "partial"])
def test_adopted_policies_are_copied_and_pickled_with_their_object(name):
    policy = adopt(OBJECTS[name](), BOX)
    policy.reset(None, 0.1, np.random.default_rng(0))
    observation = {"motion": np.ones(4, dtype=np.float32)}
    for again in (copy.copy(policy), copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert type(again).__name__ == type(policy).__name__
        assert again.control_period == 0.1
        again.reset(None, 0.2, np.random.default_rng(0))
        assert policy.control_period == 0.1
        if isinstance(policy, Explorer):
            assert again.act(None, None) == AHEAD
        else:
            np.testing.assert_array_equal(again(observation), policy(observation))


def test_attributes_are_those_of_the_object_before_and_after():
    duck = Duck()
    policy = adopt(duck)
    assert isinstance(policy, Duck)
    assert isinstance(policy, Explorer)
    assert type(policy).__name__ == "Duck"
    assert (policy.end_reason, policy.control_hz, policy.plans) == (None, None, [None])
    duck.end_reason, duck.control_hz, duck.plan = "bored", 5.0, np.zeros((1, 2))
    assert (policy.end_reason, policy.control_hz, policy.plan.shape) == ("bored", 5.0, (1, 2))
    policy.calls = 7
    assert duck.calls == 7
    assert policy.plans[0] is duck.plan
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        policy.nothing  # noqa: B018
    copied = OnePerRobot(Duck())
    copied.reset(None, 0.1, np.random.default_rng(0))
    assert copied.act([None] * 2, [None] * 2) == [AHEAD] * 2


def test_objects_with_ground_truth_are_found():
    class Spy(Duck):
        def reveal(self, coverage, target_coverage):
            self.seen = coverage

    spy = Spy()
    policy = adopt(spy)
    assert isinstance(policy, PrivilegedPolicy)
    assert marked("spy", policy) == "spy (ground truth)"
    assert not isinstance(adopt(Duck()), PrivilegedPolicy)
    with LidarEnv(Explore, **QUICK) as env:
        run_episode(env, spy, 0)
    assert spy.seen is not None
    with pytest.raises(ValueError, match="Spy uses ground truth"):
        Driver(spy, "turtlebot3_burger")


class Own(ObservationPolicy):
    def __call__(self, observation=None):
        return observation["motion"][:2]


def chooser(size=3):
    return Called()


FACTORIES = {
    "class": Duck,
    "function": lambda: Duck(),
    "defaults": chooser,
    "bound in a loop": lambda kind=Duck: kind(),
    "keyword": lambda *, kind=Duck: kind(),
    "partial": functools.partial(NearestExplorer),
    "of a class": lambda: Duck,
    "cached": functools.cache(lambda: Duck()),
}
POLICIES = {
    "optional": ahead,
    "short": lambda obs=None: obs["motion"][:2],
    "two optional": lambda observation=None, deterministic=True: observation["motion"][:2],
    "any": lambda *args, **kwargs: args[0]["motion"][:2],
    "object": Called(),
    "method": Called().__call__,
    "partial": functools.partial(ahead),
    "subclass": Own(),
}


@pytest.mark.parametrize("name", FACTORIES)
def test_classes_and_functions_without_required_arguments_make_policies(name):
    assert isinstance(adopt(FACTORIES[name]), (Duck, Called, NearestExplorer))


@pytest.mark.parametrize("name", POLICIES)
def test_an_optional_observation_does_not_make_a_factory(name):
    policy = adopt(POLICIES[name], BOX)
    policy.reset(None, 0.1, np.random.default_rng(0))
    assert policy({"motion": np.full(4, 0.3, dtype=np.float32)}).shape == (2,)


def test_what_a_function_returned_without_arguments_is_named_with_the_function():
    def stand(seen=None):
        return seen

    with pytest.raises(ValueError, match=r"None, which <function .*stand.*> returned when called without"):
        adopt(stand)
    with pytest.raises(TypeError, match=r"lambda.* was called without arguments to make a policy: 'None"):
        adopt(lambda seen=None: seen["motion"])
    with pytest.raises(ValueError, match=r"^3 is not an explorer"):
        adopt(3)


def test_functions_declare_for_the_policy_that_they_return_and_leave_it_alone():
    duck = Duck()

    def make():
        return duck

    shared = NearestExplorer()

    def make_shared():
        return shared

    make.control_hz = make_shared.control_hz = 2.0
    assert adopt(make).control_hz == adopt(make_shared).control_hz == 2.0
    assert not hasattr(duck, "control_hz")
    assert shared.control_hz is None
    policy = adopt(make_shared)
    assert isinstance(policy, NearestExplorer)
    with LidarEnv(Explore, **QUICK) as env:
        assert run_episode(env, policy, 0).path_length >= 0.0


def test_teams_and_decisions_take_objects():
    with gymnasium.make("lidarnaut/ExploreTeam-v0", physics="kinematic", time_limit=0.5) as env:
        assert run_episode(env, NearestExplorer, 0).duration > 0.0
    with gymnasium.make("lidarnaut/ExploreFrontiers-v0", physics="kinematic", time_limit=3.0) as env:
        assert run_episode(env, lambda observation=None: 0, 0).duration > 0.0
