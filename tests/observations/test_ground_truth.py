"""Observation parts and controllers use sensors and estimates only, unless they declare ground truth."""

import math
from collections.abc import Mapping

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import SyncVectorEnv

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.agents.policies import make_policy
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import begin_episode, decide_with, run_episode
from lidarnaut.baselines.policy import OnePerRobot, marked
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations import PARTS
from lidarnaut.envs.observations.positions import GOAL_MEMORY
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.crowd import person_row as person_at
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarEnvs, make_vec
from tests import own_code
from tests.rollouts import step_both
from tests.rooms import make_room
from tests.test_contract import TASKS

SMALL = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "control_hz": 5.0}
REACH = {**SMALL, "slam": "hector", "contact": "costs"}
TRUE_LIMITS = {"max_acc_v": (0.1, 0.5), "max_v": (0.1, 0.2)}
CASES = {
    "explore": ("Explore", {**SMALL, "return_home": True, "people": 2, "randomize": TRUE_LIMITS}),
    "team": ("ExploreTeam", {**SMALL, "num_robots": 2}),
    "navigate": ("Navigate", SMALL),
    "dock": ("Dock", {"start": (12.0, -10.3, 0.0), "physics": "kinematic"}),
    "sweep": ("Sweep", SMALL),
    "reach": ("ReachGoal", {**REACH, "people": 2, "randomize": TRUE_LIMITS}),
    "bearing": ("ReachGoal", {**REACH, "goal_given": "bearing"}),
    "track": ("Track", TASKS["Track"]),
}
TRUE_POSE = "x", "y", "theta"
SENSED = {
    *("left_ticks", "right_ticks", "yaw_rate", "heading", "touched", "steps", "time", "odometry", "odometry_pose"),
    *("draw", "command", "motion", "twist", "bias", "bias_variance", "pose", "key_pose", "trail", "slip"),
    *("collisions", "action_v", "action_w", "motion_settings", "odometry_settings", "period"),
}
"""Fields of a robot's record that robots know."""
TURNING = np.array([0.6, 0.3], dtype=np.float32)


def make_with_all_parts(name, arguments, **choices):
    env = gymnasium.make(f"lidarnaut/{name}-v0", **arguments).unwrapped
    parts = dict.fromkeys((*PARTS, *env.task.observation_parts())) | choices
    return gymnasium.make(f"lidarnaut/{name}-v0", **arguments, observations=parts).unwrapped


def falsified(env):
    numbers, people, hidden = env.rows.numbers.view(np.float64), env.simulator.crowd.rows, np.isnan(at.SENSED)
    numbers = numbers.reshape(len(env.robots), -1)
    tasks = [env.rows.memory[GOAL_MEMORY][:, 2:]] if GOAL_MEMORY in env.rows.memory else []  # all except goals
    kept, rng = [array.copy() for array in (numbers, people, *tasks)], np.random.default_rng(0)
    numbers[:, hidden] = rng.uniform(-9.0, 9.0, (len(numbers), hidden.sum()))
    people[:, [person_at.X, person_at.Y, person_at.VX, person_at.VY]] += 3.0
    for own in tasks:
        own[:] = rng.uniform(0.5, 9.0, own.shape)
    observation = env.observe()
    for array, before in zip((numbers, people, *tasks), kept, strict=True):
        array[...] = before
    return observation


def pairs_of_observations(case, **choices):
    """Yield observations of two equal environments; the second one has falsified ground truth."""
    name, arguments = CASES[case]
    true, false = (make_with_all_parts(name, arguments, **choices) for _ in range(2))
    for each in (true, false):
        each.begin(seed=3)
    for _ in range(12):
        yield true.observe(), falsified(false)
        for each in (true, false):
            each.apply(np.broadcast_to(TURNING, each.action_space.shape))
    assert all(each.rows.numbers["path_length"][0] > 0.05 for each in (true, false))


@pytest.mark.parametrize("case", CASES)
def test_no_part_shows_ground_truth(case):
    for shown, others in pairs_of_observations(case):
        for name, value in shown.items():
            np.testing.assert_array_equal(others[name], value, err_msg=name)
            assert np.isfinite(value).all(), name


def test_what_shows_ground_truth_says_so():
    pairs = pairs_of_observations("reach", carrot={"path": "shortest"})
    assert any((shown["carrot"] != others["carrot"]).any() for shown, others in pairs)
    for path, uses_it in (("shortest", True), ("plan", False)):
        env = LidarEnv(ReachGoal, **SMALL, observations={"carrot": {"path": path}})
        assert env.uses_ground_truth == uses_it


@pytest.mark.parametrize("case", ["explore", "reach", "bearing"])
def test_kernels_for_many_robots_show_what_single_ones_see(case):
    """A single robot has no ground truth; see `Robot.row`."""
    name, arguments = CASES[case]
    parts = dict.fromkeys(make_with_all_parts(name, arguments).parts)
    arguments = {**arguments, "observations": parts, "time_limit": 2.0}
    ours = make_vec(f"lidarnaut/{name}-v0", 2, num_workers=0, **arguments)
    theirs = SyncVectorEnv([lambda: gymnasium.make(f"lidarnaut/{name}-v0", **arguments).unwrapped] * 2)
    assert ours.get_attr("why_not_fused") == ("", "")
    for _ in step_both(ours, theirs, [np.stack([TURNING, -TURNING])] * 12):
        pass
    ours.close()


class Peek:
    def __init__(self, look, size=3):
        self.look, self.size = look, size

    def space(self, robot):
        return spaces.Box(-np.inf, np.inf, (self.size,), np.float64)

    def write(self, robot, out):
        out[:] = self.look(robot)


class PeekAtRows(Peek):
    """Part that also writes rows of many robots, and would read ground truth."""

    def write_rows(self, batch, out):
        out[:] = np.stack([batch.numbers[name] for name in TRUE_POSE], axis=1)


def test_rows_of_parts_of_ones_own_hold_no_ground_truth():
    look = PeekAtRows(lambda robot: [robot.row[name] for name in TRUE_POSE])
    assert np.isnan(LidarEnv(Explore, **SMALL, observations={"peek": look}).reset(seed=1)[0]["peek"]).all()
    many = LidarEnvs(2, task=Explore, **SMALL, num_workers=0, observations={"peek": look})
    assert np.isnan(many.reset(seed=1)[0]["peek"]).all()
    assert np.isnan(many.step(np.stack([TURNING, TURNING]))[0]["peek"]).all()
    many.close()
    env = LidarEnv(Explore, **SMALL, observations={"pose": Peek(lambda robot: robot.row["pose"])})
    env.reset(seed=1)
    np.testing.assert_array_equal(env.step(TURNING)[0]["pose"], env.belief.pose)
    env.rows.numbers["touched"][0] = at.TOUCHED_PERSON + 4  # bumpers do not report the other party
    assert env.robots[0].row["touched"] == 1.0


def test_fields_of_records_are_hidden_unless_they_are_declared_as_sensed():
    assert not at.Fields("new").is_sensed
    env = LidarEnv(Explore, **SMALL)
    env.reset(seed=1)
    env.rows.numbers.view(np.float64)[:] = 7.0
    row = env.robots[0].row
    assert {name for name in at.ROW.names if not np.isnan(row[name]).any()} == SENSED
    assert all(np.isnan(row[name]).all() for name in at.ROW.names if name not in SENSED)


def reachable(thing, seen, path="", depth=0):
    """Yield all arrays and numbers that are reachable by public attributes and items, with their access paths."""
    if id(thing) in seen or depth > 7 or isinstance(thing, (str, bytes, type, np.dtype, np.random.Generator)):
        return
    seen[id(thing)] = thing
    if isinstance(thing, float):
        yield path, thing
    if isinstance(thing, (np.ndarray, np.void)):
        yield from ((path, thing[name]) for name in thing.dtype.names or (...,))
        yield from reachable(thing.base, seen, f"{path}.base", depth + 1)
        return
    if isinstance(thing, Mapping):
        items = {f"[{key!r}]": value for key, value in thing.items()}
    elif isinstance(thing, (list, tuple)):
        items = {f"[{k}]": value for k, value in enumerate(thing[:50])}
    else:
        items = {}
    for name in dir(thing) if type(thing).__module__.startswith("lidarnaut.") else ():
        if not name.startswith("_"):
            try:
                value = getattr(thing, name)
            except AttributeError:  # set by a method that was not called
                continue
            items[f".{name}"] = value if not callable(value) or hasattr(value, "belief") else None
    for step, value in items.items():
        yield from reachable(value, seen, path + step, depth + 1)


def leaks(env, look, advance):
    """Return the attribute paths from the result of `look` to true poses, found in each round after `advance`."""
    paths = []
    for _ in range(3):  # uninitialized buffers may hold any freed memory, but not repeatedly the same pose
        advance()
        true = [value for state in env.simulator.states for value in state.pose]
        assert len(set(true)) == 3 * len(env.robots)
        found = list(reachable(look(), {}))
        assert len(found) > 10
        paths.append({path for path, value in found if np.isin(true, value).any()})
    return set.intersection(*paths)


@pytest.mark.parametrize("case", CASES)
def test_no_public_attribute_of_what_parts_and_explorers_get_leads_to_the_true_state(case):
    name, arguments = CASES[case]
    env = gymnasium.make(f"lidarnaut/{name}-v0", **arguments).unwrapped
    env.reset(seed=3)

    def advance():
        env.apply(np.broadcast_to(TURNING, env.action_space.shape))

    assert leaks(env, lambda: {"robots": env.robots, "reading": env.reading, "belief": env.belief}, advance) == set()
    assert leaks(env, lambda: {"robots": env.robots, "truths": [truth.state for truth in env.truths]}, advance)


@pytest.mark.parametrize("name", ["ExploreFrontiers", "ExploreFrontiersAbstract", "ExploreTeamFrontiers"])
def test_rules_get_no_true_state_either(name):
    env = gymnasium.make(f"lidarnaut/{name}-v0", **{**SMALL, "time_limit": 60.0}).unwrapped
    env.reset(seed=3)

    def handed():
        return {"navigator": env.navigator, "candidates": env.candidates, "belief": env.belief}

    assert leaks(env.explore, handed, lambda: env.step(0)) == set()


class Admitting(gymnasium.ObservationWrapper):
    uses_ground_truth = True

    def observation(self, observation):
        return {**observation, "truth": np.array(self.unwrapped.simulator.states[0].pose)}


def test_wrappers_and_environments_of_ones_own_say_that_they_show_ground_truth():
    class Showing(LidarEnv):
        uses_ground_truth = True

    env, (shown, circling) = LidarEnv(Explore, **SMALL), map(make_policy, (own_code.shown, own_code.Circling))
    assert marked("mine", shown, env) == marked("mine", None, env) == "mine"
    for shows in (Admitting(env), Showing(Explore, **SMALL)):
        assert marked("mine", shown, shows) == marked("mine", None, shows) == "mine (ground truth)"
        assert marked("mine", circling, shows) == "mine"
    for uses in (make_policy(own_code.Admits), make_policy(own_code.Spy), OnePerRobot(own_code.Admits())):
        assert marked("mine", uses) == marked("mine", uses, env) == "mine (ground truth)"


def drive_to(env, name, goal, steps):
    """Let a controller drive to a goal; return the goals that it receives, and its actions."""
    policy = policies_for(env)[name]()
    begin_episode(env, policy, 0, np.random.default_rng(0))
    env.unwrapped.set_goal(goal)
    decide, told, actions = decide_with(policy, env), [], []
    for _ in range(steps):
        actions.append(decide({}))
        told.append(policy.goal)
        env.step(actions[-1])
    return np.array(told), np.array(actions)


@pytest.fixture(scope="module")
def open_floor():
    world = make_room(0.0, 0.0, 20.0, 20.0, spawn=Pose2D(2.0, 2.0, 0.0))
    arguments = {"world": world, "robot": "jackal", "physics": "kinematic", "slam": "truth", "start": "spawn"}
    env = gymnasium.make("lidarnaut/ReachGoal-v0", **arguments, goal_given="bearing", observations=["goal", "carrot"])
    yield env
    env.close()


@pytest.mark.parametrize("name", ["pursuit", "pursuit:fast", "dwb", "mppi"])
def test_with_the_bearing_alone_controllers_do_not_know_how_far_the_goal_is(open_floor, name):
    (near, actions), (far, others) = (drive_to(open_floor, name, (r, r), 5) for r in (6.0, 12.0))
    np.testing.assert_array_equal(actions, others)
    np.testing.assert_array_equal(near, far)
    assert np.hypot(*near[0]) == pytest.approx(2.0)
    assert math.atan2(near[0, 1], near[0, 0]) == pytest.approx(math.pi / 4)


def test_with_the_bearing_alone_the_planned_carrot_does_not_know_it_either(open_floor):
    seen = []
    for r in (3.0, 12.0):
        open_floor.reset(seed=0, options={"goal": (r, r)})
        seen.append([open_floor.step(TURNING)[0]["carrot"] for _ in range(5)])
    first = np.array(seen)[:, 0]
    np.testing.assert_allclose(first[0], first[1], atol=0.05)  # the bearings differ once the robot has turned
    assert (np.array(seen)[..., 2] == 1.0).all()


def test_pursuit_gets_to_a_goal_of_which_it_knows_the_bearing(open_floor):
    for seed in range(2):
        episode = run_episode(open_floor, policies_for(open_floor)["pursuit"](), seed)
        assert episode.end_reason == "reached"


def test_a_goal_that_is_given_is_the_goal_itself():
    env = gymnasium.make("lidarnaut/ReachGoal-v0", **SMALL)
    env.reset(seed=0)
    policy = policies_for(env)["pursuit"]()
    run_episode(env, policy, 0)
    assert policy.goal == env.unwrapped.task.goal[:2]
