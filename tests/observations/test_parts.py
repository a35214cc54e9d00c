import pickle
from functools import partial

import numpy as np
import pytest
from gymnasium import spaces

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.navigation import planners
from lidarnaut.envs.observations import PARTS, Limits, MapCrop, Motion, Plan, Scan, ScanHistory, Trajectories
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.tasks.carrot import PlannedCarrot, ShortestCarrot
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarEnvs

ROOMS = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0}
KERNELS = {
    "scan": Scan,
    "scan_history": ScanHistory,
    "map_near": partial(MapCrop, 0.2),
    "motion": Motion,
    "limits": Limits,
    "trajectories": Trajectories,
}


class Wrapped:
    """Part of a user that contains another part."""

    def __init__(self, part):
        self.part = part

    def space(self, robot):
        return self.part.space(robot)

    def reset(self, robot):
        if hasattr(self.part, "reset"):
            self.part.reset(robot)

    def write(self, robot, out):
        self.part.write(robot, out)


class WrappedTruth(Wrapped):
    uses_ground_truth = True

    def write(self, robot, out, truth):
        self.part.write(robot, out, truth)


def extended(make):
    """Return a part of a subclass with a `write` of one robot, by the method of its base."""
    part = make()

    class Own(type(part)):
        def write(self, robot, out):
            super().write(robot, out)

    part.__class__ = Own
    return part


def shadowed(make):
    part = make()
    write = part.write
    part.write = lambda robot, out: write(robot, out)
    return part


HOWS = {"wrapped": lambda make: Wrapped(make()), "extended": extended, "shadowed": shadowed}


def twins(how):
    return dict.fromkeys(KERNELS) | {f"own_{name}": HOWS[how](make) for name, make in KERNELS.items()}


def assert_twins_equal(observation):
    for name in KERNELS:
        np.testing.assert_array_equal(observation[f"own_{name}"], observation[name], err_msg=name)


@pytest.mark.parametrize("how", HOWS)
@pytest.mark.parametrize("task", [Explore, ExploreTeam])
def test_users_may_contain_and_extend_parts_of_the_package(how, task):
    env = LidarEnv(task, **ROOMS, observations=twins(how))
    observation, _ = env.reset(seed=1)
    for _ in range(6):
        assert_twins_equal(observation)
        observation, *_ = env.step(np.full(env.action_space.shape, 0.4, dtype=np.float32))
    assert np.ptp(observation["map_near"]) > 0
    if (how, task) == ("extended", Explore):
        envs = LidarEnvs(2, task=Explore, **ROOMS, num_workers=0, observations=twins(how))
        assert_twins_equal(envs.reset(seed=1)[0])
        for _ in range(6):
            assert_twins_equal(envs.step(np.full((2, 2), 0.4, dtype=np.float32))[0])
        assert envs.get_attr("why_not_fused") == ("", "")
        envs.close()


def with_shortest(kind):
    """Return a constructor of environments with a true path, by the package and by a user's part."""
    env = LidarEnv(ReachGoal, **ROOMS, observations={"carrot": {"path": "shortest"}})
    env.parts["mine"] = kind(ShortestCarrot(env.task))
    return env


def test_a_part_with_ground_truth_is_contained_by_parts_that_declare_it_alone():
    env = with_shortest(WrappedTruth)
    env.begin(seed=2)
    ours, theirs = np.empty(3, dtype=np.float32), np.zeros(3, dtype=np.float32)
    for _ in range(3):
        env.write_part("mine", ours)
        env.write_part("carrot", theirs)
        np.testing.assert_array_equal(ours, theirs)
        env.apply(np.array([0.5, 0.5], dtype=np.float32))
    env = with_shortest(Wrapped)
    env.begin(seed=2)
    with pytest.raises(TypeError, match=r"ShortestCarrot shows ground truth: call write\(robot, out, truth\)"):
        env.write_part("mine", ours)


def test_one_robot_as_rows_hides_ground_truth_and_shares_memory():
    env = LidarEnv(ExploreTeam, **ROOMS)
    env.reset(seed=0)
    robot = env.robots[1]
    robot.remember("mine", 2)[:] = 7.0
    rows, hidden = robot.as_rows(), np.isnan(at.SENSED)
    assert rows.numbers.tobytes() == robot.row.tobytes()
    assert np.isnan(rows.numbers.view(np.float64)[hidden]).all()
    assert rows.memory["mine"].tolist() == [[7.0, 7.0]]
    assert env.rows.memory["mine"].tolist() == [[0.0, 0.0], [7.0, 7.0]]
    assert robot.as_rows(env.truths[1]).numbers.tobytes() == env.rows.numbers[1:].tobytes()


class Silent:
    def space(self, robot):
        return spaces.Box(0.0, 1.0, (1,), np.float32)


class Declares(Silent):
    uses_ground_truth = True

    def write(self, robot, out):
        out[:] = 0.0


class Peeking(Motion):
    def _write(self, rows, out):
        out[:] = np.stack([rows.numbers[name] for name in ("x", "y", "theta")], axis=1).repeat(2, axis=1)


@pytest.mark.parametrize(
    ("part", "says"),
    [
        (Silent, r"'mine' must have write\(robot, out\), got Silent: .* has no attribute 'write'"),
        (Declares, r"'mine' must have write\(robot, out, truth\), got Declares: too many positional arguments"),
        (Peeking, r"'mine' must have write\(robot, out\), got Peeking: _write is private"),
    ],
)
def test_parts_without_the_methods_of_the_interface_are_refused_when_the_environment_is_made(part, says):
    with pytest.raises(ValueError, match=says):
        LidarEnv(Explore, **ROOMS, observations={"mine": part})


@pytest.mark.parametrize("task", [Explore, ExploreTeam])
def test_a_running_environment_with_all_parts_can_be_copied(task):
    env = LidarEnv(task, **ROOMS, observations=tuple(PARTS))
    env.reset(seed=4)
    action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
    env.step(action)
    other = pickle.loads(pickle.dumps(env))
    assert other.rows.numbers.dtype is other.period.numbers.dtype is at.ROW  # else calls of kernels take 2 us longer
    assert np.shares_memory(other.rows.numbers, other.period.numbers)
    for _ in range(3):
        ours, theirs = (each.step(action)[0] for each in (env, other))
        for name, value in ours.items():
            np.testing.assert_array_equal(theirs[name], value, err_msg=name)


SHARED = {
    "plan": (Explore, "FrontierNavigator", lambda env: Plan()),
    "carrot": (ReachGoal, "GoalNavigator", lambda env: PlannedCarrot(env.task)),
}


@pytest.mark.parametrize("name", SHARED)
def test_parts_of_a_robot_share_one_planner_and_see_what_each_would_see_alone(name, monkeypatch):
    (task, kind, make), made = SHARED[name], []
    original = getattr(planners, kind)
    monkeypatch.setattr(planners, kind, lambda *args, **limits: made.append(kind) or original(*args, **limits))

    def begun(*names):
        env = LidarEnv(task, **ROOMS, observations=(name,))
        parts = {name: env.parts[name], "second": make(env)}
        env.parts = {each: parts[each] for each in names}
        env.begin(seed=3)
        return env

    def entry(env, part):
        out = np.empty(env.parts[part].size, dtype=np.float32)
        env.write_part(part, out)
        return out

    alone, both = {part: begun(part) for part in (name, "second")}, begun(name, "second")
    for _ in range(12):
        for part, env in alone.items():
            np.testing.assert_array_equal(entry(both, part), entry(env, part))
        for env in (*alone.values(), both):
            env.apply(np.array([0.5, 0.2], dtype=np.float32))
    assert made == [kind] * 3


def test_without_a_limit_of_recoveries_a_planner_never_gives_up():
    env = LidarEnv(ReachGoal, **ROOMS, observations=("carrot",))
    env.reset(seed=0)
    planner = env.robots[0].planner("goal", None)
    for time in range(1, 200):
        reading = env.reading._replace(time=float(time), bumper=True)
        path = planner.update(reading, env.belief, (1.0, 1.0))
    assert len(path)
    assert planner._navigator.num_recoveries > 6
    assert planner._navigator.end_reason is None
