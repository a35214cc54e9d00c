import subprocess
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence as same

from envs.core import LidarEnv
from envs.geometry import Pose2D
from envs.observations import PARTS
from envs.robots import load_robot
from envs.tasks.explore import Explore
from envs.worlds import World
from tests.rollouts import rollout

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0}
INFO_KEYS = {
    "explored_fraction",
    "explored_area",
    "pose_error",
    "path_length",
    "collisions",
    "time",
    "rewards",
    "is_success",
}


# Draws that fell on a mover, which `reset` refused.
@pytest.mark.parametrize(
    ("world", "seed"),
    [("turtlebot3_stage_3", 4), ("turtlebot3_stage_4", 18), ("turtlebot3_dqn_stage3", 21)],
)
def test_reset_keeps_clear_of_movers(world, seed):
    env = LidarEnv(Explore, world=world, physics="kinematic", slam="truth")
    env.reset(seed=seed)
    assert not env.step(np.zeros(2, dtype=np.float32))[4]["collisions"]


def hall(length):
    """A hall 2 m wide whose farther end is out of sight from its nearer one."""
    near = [(0, 2, 0, 0), (0, 0, 8, 0), (0, 2, 8, 2), (3, 0, 3, 0.8)]
    far = [(8, 0, length, 0), (8, 2, length, 2), (length, 0, length, 2)]
    return World(
        name="hall",
        segments=np.array([*near, *far], dtype=float),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(1.0, 1.0, 0.0),),
        bounds=(0.0, 0.0, length, 2.0),
    )


@pytest.mark.parametrize(
    ("id", "steps", "arguments"),
    [
        ("Explore", 12, {"observations": (*PARTS, "home"), "return_home": True}),
        ("ExploreFrontiers", 3, {}),
        ("ExploreTeam", 12, {"num_robots": 2, "observations": (*PARTS, "teammates")}),
    ],
)
def test_observations_tell_neither_the_time_limit_nor_what_is_out_of_sight(id, steps, arguments):
    def observe(length, **limit):
        common = {"world": hall(length), "physics": "kinematic", "start": "spawn", **arguments}
        env = gymnasium.make(f"lidarnaut/{id}-v0", **common, **limit)
        env.action_space.seed(0)
        return [env.reset(seed=0)[0], *(env.step(env.action_space.sample())[0] for _ in range(steps))]

    first = observe(14.0)
    assert same(first, observe(14.0, time_limit=3000.0))
    assert same(first, observe(40.0))


def test_info_has_every_key_and_rewards_sum_up():
    env = LidarEnv(Explore, **QUICK, time_limit=4.0)
    out = rollout(env, 2, 100)
    assert set(out[0][1]) == INFO_KEYS
    for _, reward, _, _, info in out[1:]:
        assert set(info) - {"map_iou", "area_left", "end_reason"} == INFO_KEYS
        assert reward == pytest.approx(sum(info["rewards"].values()))
        assert set(info["rewards"]) == {"explored", "time", "collision", "completed"}
    assert out[-1][3] is True
    assert out[-1][4]["end_reason"] == "time_limit"
    assert 0.0 < out[-1][4]["map_iou"] <= 1.0
    # Truncated at the first step that reaches the limit: 4 s at 5 Hz are 20 steps.
    assert len(out) == 21


def test_explored_area_grows_by_what_was_rewarded():
    env = LidarEnv(Explore, **QUICK, reward={"explored": 2.0})
    out = rollout(env, 3, 60)
    rewarded = sum(step[4]["rewards"]["explored"] for step in out[1:])
    assert rewarded == pytest.approx(2.0 * (out[-1][4]["explored_area"] - out[0][1]["explored_area"]))
    assert rewarded > 0


def test_reaching_the_target_terminates():
    env = LidarEnv(Explore, **QUICK, target_coverage=0.05)
    env.reset(seed=0)
    _, _, terminated, truncated, info = env.step(np.zeros(2, dtype=np.float32))
    assert terminated is True
    assert truncated is False
    assert info["is_success"]
    assert info["end_reason"] == "covered"
    assert info["rewards"]["completed"] == Explore.weights["completed"]


def test_driving_into_a_wall_is_counted_and_does_not_end_the_episode():
    env = LidarEnv(Explore, **QUICK, slam="truth")
    env.reset(seed=0)
    ahead = np.array([1.0, 0.0], dtype=np.float32)
    infos = [env.step(ahead)[4] for _ in range(150)]
    assert infos[-1]["collisions"] >= 1
    assert min(info["rewards"]["collision"] for info in infos) < 0


def test_ground_truth_has_no_pose_error_and_tinyslam_keeps_the_heading_that_wheels_lose():
    burger, position, heading = load_robot("turtlebot3_burger"), {}, {}
    robot = replace(burger, odometry=replace(burger.odometry, uses_gyro=False))
    for slam in ("truth", "odometry", "tinyslam"):
        env = LidarEnv(Explore, **QUICK, slam=slam, robot=robot)
        ends = np.array([rollout(env, seed, 200)[-1][4]["pose_error"] for seed in range(4)])
        position[slam], heading[slam] = ends.mean(axis=0)
    assert position["truth"] + heading["truth"] < 1e-9
    assert position["odometry"] > 1e-3
    assert position["tinyslam"] < 0.05
    assert heading["tinyslam"] < 0.3 * heading["odometry"]


@pytest.mark.parametrize(
    ("kwargs", "culprit"),
    [
        ({"world": "atlantis"}, "atlantis"),
        ({"robot": "r2d2"}, "r2d2"),
        ({"physics": "mujoco"}, "mujoco"),
        ({"slam": "cartographer"}, "cartographer"),
        ({"reward": {"explred": 1.0}}, "explred"),
        ({"reward": {"time": float("nan")}}, "time"),
        ({"start": (float("nan"), 0.0, 0.0)}, "start"),
        ({"time_limit": -1.0}, "time_limit"),
        ({"target_coverage": 1.5}, "target_coverage"),
        *(({"start": wrong}, "start must be") for wrong in ("home", 5, None, (1.0, "b", 0.0))),
        ({"render_mode": "ascii"}, "render_mode"),
        ({"split": "validation"}, "split"),
        *(({"control_hz": wrong}, "control_hz must be positive") for wrong in (0, "10", 10**400, True, None)),
        ({"observations": ([],)}, r"observations must have names, got \[\]"),
        ({"control_hz": 1e9}, r"control_period must be .* at least 0.0001 s \(10,000 Hz\)"),
        ({"time_limit": "5"}, "time_limit must be positive or None, got '5'"),
        ({"target_coverage": "0.9"}, "target_coverage must lie in"),
        ({"map_resolution": "fine"}, "map_resolution must be positive"),
        ({"world": "rooms", "world_size": 8}, "size must be"),
        ({"world": "atlantis", "world_size": (8, 8)}, "unknown world 'atlantis'"),
        ({"world": "os:path"}, "world 'os:path' must name a World"),
        ({"robot": "os:path"}, "robot 'os:path' must name RobotParams"),
        ({"reward": {"time": "a"}}, "reward weight 'time' must be finite"),
        ({"reward": "a"}, "unknown reward 'a'; allowed is module:attribute"),
        ({"randomize": 5}, "randomize must map names"),
        ({"observations": "scan"}, "observations must be a sequence of names .* got 'scan'"),
        ({"observations": (5,)}, "observations must have names, got 5"),
        ({"observations": {"scan": 5}}, "'scan' must be a part or make one, got 5"),
        ({"observations": {"map_near": {"size": 1.5}}}, "whole size from 1 to 4,096, got 1.5"),
        ({"observations": {"map_near": {"size": 10**6}}}, "whole size from 1 to 4,096"),
        ({"observations": {"map_near": {"resolution": "a"}}}, "positive resolution, got 'a'"),
    ],
)
def test_bad_arguments_are_named(kwargs, culprit):
    with pytest.raises(ValueError, match=culprit):
        LidarEnv(Explore, **{"physics": "kinematic", **kwargs})


def test_import_registers_and_stays_light():
    code = (
        "import gymnasium, sys; env = gymnasium.make('envs:lidarnaut/Explore-v0', physics='kinematic');"
        "heavy = {'torch', 'stable_baselines3', 'pygame', 'matplotlib', 'pybullet'} & set(sys.modules); print(heavy)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def test_works_without_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    rollout(LidarEnv(Explore, **QUICK), 0, 3)
    with pytest.raises(ImportError, match="kinematic"):
        LidarEnv(Explore, physics="bullet").reset(seed=0)


def make_quick():
    return gymnasium.make("lidarnaut/Explore-v0", **QUICK)


def test_vector_environments_agree_with_single_ones():
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 2, 2)).astype(np.float32)
    singles = [make_quick() for _ in range(2)]
    for k, env in enumerate(singles):
        env.reset(seed=10 + k)
    expected = [[env.step(action[k])[1] for k, env in enumerate(singles)] for action in actions]
    for context in ("spawn", "forkserver"):
        vector = gymnasium.vector.AsyncVectorEnv([make_quick] * 2, context=context)
        vector.reset(seed=10)
        rewards = [vector.step(action)[1] for action in actions]
        np.testing.assert_allclose(rewards, expected)
        vector.close()
