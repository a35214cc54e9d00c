import itertools
import math
import pickle
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_checker import data_equivalence as same
from numba.core.errors import NumbaExperimentalFeatureWarning

try:
    from stable_baselines3.common.env_checker import check_env as check_sb3
except ImportError:
    check_sb3 = None

from lidarnaut.envs.measures import PEOPLE
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.explore import Explore

IDS = [id for id in gymnasium.registry if id.startswith("lidarnaut/")]
ROOMS = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic"}
TASKS = {
    "Explore": {**ROOMS, "control_hz": 5.0},
    "ExploreTeam": {**ROOMS, "control_hz": 5.0, "num_robots": 3},
    "ExploreFrontiers": {**ROOMS, "world_size": (10.0, 10.0)},
    "ExploreTeamFrontiers": {**ROOMS, "world_size": (10.0, 10.0), "num_robots": 3},
    "Navigate": {"world": "turtlebot3_world", "physics": "kinematic"},
    "Dock": {"start": (13.0, -10.3, 0.5), "physics": "kinematic"},
    "Sweep": {"world": "turtlebot3_world", "robot": "turtlebot3_burger", "physics": "kinematic"},
    "ReachGoal": {"world": "turtlebot3_world", "physics": "kinematic", "contact": "costs"},
    "ReachCrowd": {"physics": "kinematic", "contact": "costs", "people": (3, 6)},
    "Track": {
        **{"world": "turtlebot3_world", "robot": "turtlebot3_burger", "physics": "kinematic", "control_hz": 5.0},
        **{"path": [[-2.0, -0.5], [-0.55, -0.55], [-0.55, 0.55], [-2.0, 0.5]], "map_resolution": 0.1},
    },
}
STILL, AHEAD = np.zeros(2, dtype=np.float32), np.array([1.0, 0.0], dtype=np.float32)
every_task = pytest.mark.parametrize("task", TASKS)


def make(task, **arguments):
    return gymnasium.make(f"lidarnaut/{task}-v0", disable_env_checker=True, **TASKS.get(task, ROOMS) | arguments)


def rollout(env, seed, steps, action=None):
    env.action_space.seed(seed)
    out = [env.reset(seed=seed)]
    while len(out) <= steps and not (len(out) > 1 and (out[-1][2] or out[-1][3])):
        out.append(env.step(env.action_space.sample() if action is None else action))
    return out


@pytest.mark.parametrize(("id", "physics"), [*((id, "kinematic") for id in IDS), ("lidarnaut/Explore-v0", "bullet")])
def test_both_checkers_have_no_complaint(id, physics):
    arguments = {"physics": physics, "time_limit": 30.0, "render_mode": "rgb_array", "disable_env_checker": True}
    short = TASKS["Track"] if "Track" in id else {}  # the map of the default route takes long
    env = gymnasium.make(id, **short | arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)  # of Numba 0.61, during compilation
        check_env(env.unwrapped, skip_render_check=id.removeprefix("lidarnaut/").removesuffix("-v0") not in TASKS)
        # Warning about two-dimensional observations of candidates, robots and route points, which need custom networks.
        warnings.filterwarnings("ignore", message="Your observation .* has an unconventional shape .*neither an image")
        if check_sb3 is not None:
            check_sb3(env.unwrapped)
    env.close()


BULLET = [(task, "bullet") for task in ("Explore", "ExploreTeam", "ExploreFrontiers", "ReachCrowd")]


@pytest.mark.parametrize(("task", "physics"), [*((task, "kinematic") for task in TASKS), *BULLET])
def test_same_seed_same_bytes_in_copies_too(task, physics):
    env, other = (make(task, physics=physics, render_mode="rgb_array") for _ in range(2))
    steps = 4 if "Frontiers" in task else 8
    first = rollout(env, 7, steps)
    env.render()
    for each in (env, other, pickle.loads(pickle.dumps(env)), gymnasium.make(EnvSpec.from_json(env.spec.to_json()))):
        assert same(first, rollout(each, 7, steps))
        each.reset(seed=8)
    assert not same(first, rollout(other, 9, steps))
    if physics == "kinematic":  # a copy goes on where its original was
        copy, action = pickle.loads(pickle.dumps(other)), other.action_space.sample()
        assert same(other.step(action), copy.step(action))
    env.close()
    other.close()


@every_task
def test_observations_share_no_memory_and_no_part_stays_constant(task):
    env = make(task, max_deviation=9.0) if task == "Track" else make(task)
    observations = [step[0] for step in rollout(env, 1, 60)]
    for before, after in itertools.pairwise(observations):
        assert not any(np.shares_memory(before[key], after[key]) for key in before)
    for key in set(observations[0]) - {"robot", "action_mask"}:
        assert any((observation[key] != observations[0][key]).any() for observation in observations)
    scans = [env.reset(seed=seed)[0].get("scan", np.arange(seed)) for seed in range(2)]
    assert not np.array_equal(*scans)


@every_task
def test_the_docstring_tells_each_space_as_it_is(task):
    env = make(task).unwrapped
    lines = (env if "Frontiers" in task else env.task).__doc__.splitlines()
    spaces = dict(line.split("`")[1::2][:2] for line in lines if line.strip().startswith("| `") and "(" in line)
    names = {"num_beams": 360, "num_robots": 3, "max_candidates": 48, "float32": np.float32, "uint8": np.uint8}
    names |= {"Box": lambda low, high, shape, dtype: gymnasium.spaces.Box(low, high, shape, dtype)}
    for key, space in env.observation_space.spaces.items():
        assert eval(spaces[key], names | {"MultiBinary": gymnasium.spaces.MultiBinary}) == space


NO_NUMBERS = (STILL.astype(complex), np.ma.masked_array(STILL, [True, False]), ["0.5", "0.5"], [None, 0.0], [True] * 2)


@every_task
def test_bad_actions_are_refused(task):
    env = make(task).unwrapped
    env.reset(seed=0)
    shape = env.action_space.shape
    wrong = [np.full(shape, value) if shape else value for value in (np.nan, np.inf, 1.5, -2, 10**6)]
    for action in (*wrong, np.zeros((1, *shape))):
        with pytest.raises(ValueError, match="action must"):
            env.step(action)
    if task == "Explore":
        vector = gymnasium.make_vec("lidarnaut/Explore-v0", 1, num_workers=0, **TASKS[task])
        vector.reset(seed=0)
        for action in NO_NUMBERS:
            for each, given in ((env, action), (vector, [action] if isinstance(action, list) else action[None])):
                with pytest.raises(ValueError, match="action must hold real numbers, got"):
                    each.step(given)


MOTION = {"pose_error", "path_length", "collisions", "time", "rewards", "is_success"}
EXPLORED = MOTION | {"explored_fraction", "explored_area"}
DECISION = {"action_mask", "action", "outcome", "decision_time", "decision_length", "decision_steps", "area_left"}
TO_GOAL = MOTION | {"distance_to_goal", "geodesic_distance", "progress"}
INFO_KEYS = {
    "Explore": EXPLORED,
    "ExploreTeam": EXPLORED,
    "ExploreFrontiers": EXPLORED | DECISION,
    "ExploreTeamFrontiers": EXPLORED | DECISION | {"robot"},
    "Navigate": TO_GOAL | {"is_lost"},
    "Dock": TO_GOAL | {"is_lost", "heading_error", "charge", "is_docked"},
    "Sweep": MOTION | {"swept_fraction", "swept_area", "is_lost"},
    "ReachGoal": TO_GOAL,
    "ReachCrowd": TO_GOAL,
    "Track": MOTION | {"deviation", "progress", "is_lost"},
}


@every_task
def test_info_has_every_key_rewards_sum_up_and_time_runs_out(task):
    env = make(task, time_limit=4.0, **({"max_deviation": 9.0} if task == "Track" else {}))
    out = rollout(env, 2, 100)
    assert all(set(step[-1]) == INFO_KEYS[task] for step in out[:-1])
    weights = getattr(env.unwrapped, "task", Explore).weights
    for _, reward, _, _, info in out[1:]:
        assert reward == pytest.approx(sum(info["rewards"].values()))
        assert set(info["rewards"]) == set(weights)
    assert out[-1][2:4] == (False, True)
    assert (info["end_reason"], info["time"]) == ("time_limit", pytest.approx(4.0))
    further = {"map_iou", "area_left"} if "Explore" in task else set()
    further |= {"at_fault", "jerk", "barn_metric"} if "Reach" in task else set()
    if task == "ReachCrowd":
        assert {*PEOPLE} <= {*env.unwrapped.task.measures}
        further |= {measure.name for measure in PEOPLE}
    assert set(info) == INFO_KEYS[task] | {"end_reason"} | further
    assert 0.0 < info.get("map_iou", 1.0) <= 1.0


@pytest.mark.parametrize(
    ("task", "term", "quantity", "sign"),
    [
        ("Explore", "explored", "explored_area", 1),
        ("Navigate", "progress", "geodesic_distance", -1),
        ("Dock", "progress", "geodesic_distance", -1),
        ("Sweep", "swept", "swept_area", 1),
        ("ReachGoal", "progress", "geodesic_distance", -1),
    ],
)
def test_rewards_add_up_to_what_has_changed(task, term, quantity, sign):
    out = rollout(make(task, reward={term: 2.0}), 3, 60)
    rewarded = sum(step[4]["rewards"][term] for step in out[1:])
    change = out[-1][4][quantity] - out[0][1][quantity]
    assert rewarded == pytest.approx(2.0 * sign * change)
    assert rewarded != 0.0


NEAR = {"localizer": "truth", "start": (-2.0, -0.5, 0.0), "goal": (-1.4, -0.5, 0.0)}


@pytest.mark.parametrize(
    ("task", "arguments", "action", "reason", "term"),
    [
        ("Explore", {"target_coverage": 0.05}, STILL, "covered", "completed"),
        ("ExploreFrontiers", {"target_coverage": 0.5}, 0, "covered", "completed"),
        ("Navigate", NEAR, AHEAD, "reached", "reached"),
        ("Sweep", {"target_swept": 0.01, "start": (-2.0, -0.5, 0.0)}, AHEAD, "swept", "completed"),
        ("ReachGoal", {"start": (-2.0, -0.5, 0.0), "goal": (0.6, 0.0, 0.0)}, AHEAD, "reached", "reached"),
    ],
)
def test_success_terminates_and_pays(task, arguments, action, reason, term):
    env = make(task, **arguments).unwrapped
    *_, (_, _, terminated, truncated, info) = rollout(env, 0, 100, action)
    assert (terminated, truncated, info["end_reason"], info["is_success"]) == (True, False, reason, True)
    assert info["rewards"][term] == getattr(env, "task", Explore).weights[term]
    assert 0.25 < info.get("distance_to_goal", 0.3) <= 0.3


BURGER = load_robot("turtlebot3_burger")
SPINNING = replace(BURGER, lidar=replace(BURGER.lidar, scan_time=0.18))
IGNORED = {"observations": ("scan",), "clip_actions": True}
BAD_ARGUMENTS = [
    ("Explore", {"robot": "r2d2"}, "r2d2"),
    ("Explore", {"physics": "mujoco"}, "mujoco"),
    ("Explore", {"slam": "cartographer"}, "cartographer"),
    ("Explore", {"reward": {"explred": 1.0}}, "explred"),
    ("Explore", {"start": (math.nan, 0.0, 0.0)}, "start"),
    *(("Explore", {"start": wrong}, "start must be") for wrong in ("home", 5, None, (1.0, "b", 0.0))),
    ("Explore", {"render_mode": "ascii"}, "render_mode"),
    ("Explore", {"split": "holdout"}, "split"),
    *(("Explore", {"control_hz": wrong}, "control_hz must be positive") for wrong in (0, "10", 10**400, True, None)),
    ("Explore", {"observations": ([],)}, r"names of observations must be strings, got \[\]"),
    ("Explore", {"control_hz": 1e9}, r"control_period must be .* at least 0.0001 s \(10,000 Hz\)"),
    ("Explore", {"time_limit": "5"}, "time_limit must be positive or None, got '5'"),
    ("Explore", {"target_coverage": 1.5}, "target_coverage must lie in"),
    ("Explore", {"map_resolution": "fine"}, "map_resolution must be positive"),
    ("Explore", {"world": "rooms", "world_size": 8}, "size must be"),
    ("Explore", {"world": "atlantis", "world_size": (8, 8)}, "unknown world 'atlantis'"),
    ("Explore", {"world": "os:path", "world_size": None}, "world 'os:path' must name a World"),
    ("Explore", {"robot": "os:path"}, "robot 'os:path' must name RobotParams"),
    ("Explore", {"reward": {"time": "a"}}, "reward weight 'time' must be finite"),
    ("Explore", {"reward": "a"}, "unknown reward 'a'; allowed is module:attribute"),
    ("Explore", {"randomize": 5}, "randomize must map names"),
    ("Explore", {"randomize": {"lidar.noise": (0.0, 0.1)}}, r"\['lidar.noise'\].*allowed are \[.*'lidar.noise_std'"),
    ("Explore", {"randomize": {"radius": (0.1, 0.2)}}, r"\['radius'\].*allowed are"),
    ("Explore", {"randomize": {"drive.friction": (0.4, 1.0)}}, r"\['drive.friction'\].*no effect"),
    ("Explore", {"randomize": {"imu.compass_std": (0.0, 0.1)}}, r"\['imu.compass_std'\].*no effect"),
    ("Explore", {"randomize": {"lidar.noise_std": 0.1}}, r"'lidar.noise_std'.*two numbers \(low, high\), got 0.1"),
    ("Explore", {"randomize": {"lidar.noise_std": (0.1, 0.0)}}, r"'lidar.noise_std'.*low <= high"),
    ("Explore", {"randomize": {"lidar.noise_std": (0.1, np.inf)}}, r"'lidar.noise_std'.*finite"),
    ("Explore", {"randomize": {"lidar.noise_std": (-0.1, 0.1)}}, r"'lidar.noise_std'.*or equal to 0, got -0.1"),
    ("Explore", {"randomize": {"max_v": (0.1, 0.3)}}, r"'max_v'.*must not exceed the robot's 0.22"),
    ("ExploreFrontiersAbstract", {"randomize": {"max_v": (0.1, 0.2)}}, r"only lidar parameters.*\['max_v'\]"),
    ("Explore", {"observations": ()}, "at least one"),
    ("Explore", {"observations": {"sound": None}}, "sound"),
    ("Explore", {"observations": {"scan": "no_such_module:Part"}}, "no_such_module"),
    ("Explore", {"observations": "scan"}, "observations must be a sequence of names .* got 'scan'"),
    ("Explore", {"observations": {"scan": 5}}, "'scan' must be an observation part or return one, got 5"),
    ("Explore", {"observations": {"map_near": {"size": 10**6}}}, "whole size from 1 to 4,096"),
    ("Explore", {"observations": {"map_near": {"resolution": "a"}}}, "positive resolution, got 'a'"),
    ("ExploreTeam", {"num_robots": 5}, "num_robots"),
    ("ExploreTeam", {"num_robots": 1.5}, "num_robots"),
    ("ExploreTeam", {"start": np.zeros((3, 3)), "num_robots": 2}, "start must be"),
    ("ExploreTeam", {"start": ((1.0, 1.0, 0.0),), "num_robots": 2}, "start"),
    ("ExploreTeam", {"start": ((1.0, 1.0, 0.0), (1.0, math.nan, 0.0)), "num_robots": 2}, "start"),
    ("ExploreFrontiers", {"max_candidates": 5.0}, "max_candidates must be an integer"),
    ("ExploreFrontiers", {"max_candidates": 10**9}, "max_candidates .* from 1 to 1,000"),
    ("ExploreFrontiers", {"max_decision_time": "4"}, "max_decision_time"),
    *(("ExploreFrontiers", {n: v}, f"{n!r} has no effect .* lidarnaut/Explore-v0") for n, v in IGNORED.items()),
    *(("ExploreTeamFrontiers", {n: v}, f"{n!r} has no effect .* lidarnaut/ExploreTeam-v0") for n, v in IGNORED.items()),
    ("ExploreTeamFrontiers", {"collision_monitor": True}, "'collision_monitor' .* lidarnaut/ExploreTeam-v0"),
    *(
        ("ExploreFrontiersAbstract", {name: value}, f"{name!r} has no effect .* lidarnaut/ExploreFrontiers-v0")
        for name, value in {"people": 3, "track_people": True, "sensors": [object()], "collision_monitor": True}.items()
    ),
    ("ExploreFrontiersAbstract", {"robot": SPINNING}, "lidar.scan_time has no effect"),
    ("ExploreFrontiersAbstract", {"reward": {"jerk": -1.0}}, r"\['jerk'\] have no .* lidarnaut/ExploreFrontiers-v0"),
    ("Navigate", {"localizer": "gps"}, "gps"),
    ("Navigate", {"amcl": "nav3"}, "nav3"),
    ("Navigate", {"initial_pose": "unknown", "localizer": "odometry"}, "initial_pose='unknown' needs"),
    ("Navigate", {"goal_tolerance": 0.0}, "goal_tolerance"),
    ("Navigate", {"heading_tolerance": 4.0}, "heading_tolerance"),
    ("Navigate", {"goal": (0.0, math.nan, 0.0)}, "goal must be"),
    ("Navigate", {"goal": np.zeros((3, 3))}, "goal must be"),
    ("Navigate", {"map_pose": (0.0, 0.0)}, "map_pose"),
    ("Navigate", {"map_pose": (1.0, 2.0, 0.3)}, "needs a map"),
    ("Navigate", {"map_pose": "spawn"}, "needs a map"),
    ("Explore", {"slam": "hector?max_range=0.01"}, "slam 'hector.max_range=0.01': max_range must exceed"),
    ("Navigate", {"map": "nowhere.yaml"}, "nowhere.yaml"),
    ("Dock", {"start_charge": (0.0, 0.5)}, r"start_charge must be \(low, high\)"),
    *(("Dock", {"start_charge": wrong}, "start_charge must be") for wrong in (0.5, ("a", "b"), None, (0.3, 0.1))),
    *(("Dock", {"target_charge": wrong}, "target_charge must lie in") for wrong in (1.5, "x", None)),
    ("Dock", {"min_distance": -1.0}, "min_distance must be"),
    ("Sweep", {"target_swept": 0.0}, "target_swept must lie in"),
    ("ReachGoal", {"goal": "home"}, "goal must be 'random', 'world' or"),
    ("ReachGoal", {"goal_given": "distance"}, "goal_given must be 'pose' or 'bearing'"),
    ("ReachGoal", {"contact": "hurts"}, "contact must be 'ends' or 'costs'"),
    ("ReachGoal", {"min_distance": 0.0}, "min_distance"),
    ("ReachGoal", {"slam": "gps"}, "gps"),
    ("ReachGoal", {"observations": {"scan_history": {"lags": (0.2, 0.1)}}}, "increasing lags"),
    ("ReachGoal", {"observations": {"scan_history": {"num_sectors": 0}}}, "positive number of sectors"),
    ("ReachGoal", {"observations": {"scan_history": {"num_sectors": 500}}}, "500 sectors of the 360 beams"),
    ("Track", {"fusion": "gps"}, "fusion 'gps'.*encoder_compass"),
    ("Track", {"fusion": "encoder_compass"}, "needs a compass"),
    ("Track", {"path": [[0.0, 0.0], [0.0, math.nan]]}, "path"),
    ("Track", {"max_deviation": -1.0}, "max_deviation"),
    ("Track", {"map": 3}, "map must be a path"),
    ("Track", {"map_pose": (1.0, 2.0, 0.3)}, "needs a map"),
    ("Track", {"map_pose": "x"}, "'spawn'"),
    ("Track", {"map_latency": -0.1}, "map_latency"),
    ("Track", {"start_spread": (0.1, -0.1)}, "start_spread"),
    ("ExploreFrontiersAbstract", {"physics": "bullet"}, "physics must be 'slide'"),
    ("ExploreFrontiersAbstract", {"slam": "hector"}, "slam must be 'truth'"),
    ("ExploreFrontiersAbstract", {"scan_distance": 0.0}, "scan_distance"),
    ("ExploreFrontiersAbstract", {"drift": (0.1, -0.1)}, "drift"),
    ("ExploreFrontiersAbstract", {"false_returns": 1.0}, "false_returns"),
]


@pytest.mark.filterwarnings("ignore:.*possible render_modes")
@pytest.mark.parametrize(("task", "arguments", "culprit"), BAD_ARGUMENTS)
def test_bad_arguments_are_named(task, arguments, culprit):
    with pytest.raises((ValueError, FileNotFoundError), match=culprit):
        make(task, **arguments)


@every_task
def test_steps_and_pictures_before_a_reset_are_refused(task):
    env = make(task, render_mode="rgb_array").unwrapped
    for _ in range(2):
        for call in (lambda: env.step(env.action_space.sample()), env.render):
            with pytest.raises(gymnasium.error.ResetNeeded, match="no episode has begun"):
                call()
        env.reset(seed=0)
        env.close()
