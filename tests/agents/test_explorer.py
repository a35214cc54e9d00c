from functools import partial
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from lidarnaut.agents.algorithms import Actor
from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.learned import find_policy
from lidarnaut.agents.policies import make_policy
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import GymnasiumVecEnv, make_env, make_vector
from lidarnaut.baselines.episode import run_episode
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs.files import parse_record
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.robots import load_robot
from tests.agents.fake_env import BEAMS
from tests.agents.tiny import tiny, untrained


@pytest.fixture
def env(tiny_config):
    return make_env(tiny_config.environment, "test")


def ready(explorer, env, seed=0):
    explorer.reset(env.unwrapped.robot_params, env.unwrapped.control_period, np.random.default_rng(seed))
    return explorer


def test_drawn_actions_come_from_the_generator_alone(tiny_run, env):
    explorer = LearnedPolicy.load(tiny_run, deterministic=False, trust="tests")
    observation, _ = env.reset(seed=1)

    def draw(seed):
        torch.rand(3)
        ready(explorer, env, seed)
        return np.array([explorer(observation) for _ in range(400)])

    first = draw(5)
    assert np.array_equal(first, draw(5))
    assert not np.array_equal(first, draw(6))
    mean = ready(LearnedPolicy.load(tiny_run, trust="tests"), env)(observation)
    assert np.allclose(first.mean(axis=0), mean, atol=0.15)
    assert (first.std(axis=0) > 0.3).all()


def test_what_does_not_fit_is_reported(tiny_run, env):
    explorer = LearnedPolicy.load(tiny_run, trust="tests")
    robot = SimpleNamespace(name="other", lidar=SimpleNamespace(num_beams=360))
    with pytest.raises(CheckpointError, match=f"needs scans of {BEAMS} beams, but the lidar of robot 'other' has 360"):
        explorer.reset(robot, 0.2, np.random.default_rng(0))
    ready(explorer, env)
    observation, _ = env.reset(seed=1)
    del observation["map_far"]
    with pytest.raises(CheckpointError, match=r"needs observations .*map_far Box\(0, 255, \(3, 40, 40\), uint8\)"):
        explorer(observation)


ROOMS = {"world": "rooms", "world_size": [7, 7], "control_hz": 5.0, "num_workers": 0, "time_limit": 1.0}
ROOMS |= {"id": "lidarnaut/Explore-v0"}


class Position:
    """Observation part without bounds."""

    def space(self, robot):
        return spaces.Box(-np.inf, np.inf, (1,), np.float32)

    def write(self, robot, out):
        out[0] = robot.belief.pose.x


def test_scans_of_other_lidars_are_shown_as_that_of_the_training_beside_parts_without_bounds(tmp_path):
    trained, parts = "turtlebot3_waffle_pi", {"scan": None, "motion": None, "position": f"{__name__}:Position"}
    environment = {**ROOMS, "robot": trained, "observations": parts}
    run = train(tiny("PPO", "Explore", environment=environment), run=tmp_path / "run", progress=False)

    def act(name, distance):
        explorer, robot = LearnedPolicy.load(run, trust="tests"), load_robot(name)
        explorer.reset(robot, 0.2, np.random.default_rng(0))
        bearings = wrap_angle(robot.lidar.angles + robot.lidar.mount.yaw)
        ranges = np.where(np.abs(bearings) < 0.5, distance, np.inf)
        scan = np.minimum(ranges / robot.lidar.range_max, 1.0).astype(np.float32)
        assert explorer.observations == parts
        return explorer({"scan": scan, "motion": np.zeros(6, np.float32), "position": np.ones(1, np.float32)})

    assert act("create3", 0.4) == pytest.approx(act(trained, 0.4), abs=0.002)
    assert act(trained, 0.4) != pytest.approx(act(trained, np.inf), abs=0.002)


def test_an_untrained_policy_drives_ahead_as_configured(tiny_config):
    vector = GymnasiumVecEnv(make_vector(tiny_config.environment, "train", 4))
    model = untrained(tiny_config.model_copy(update={"network": {"speed": 0.6}}), vector)
    assert Actor(model.policy)(vector.reset())[0] == pytest.approx([0.6, 0.0], abs=0.1)


def test_the_policy_of_the_package_explores_a_small_world_without_contact():
    driver = LearnedPolicy.load(find_policy("pretrained/twist"))
    room = {"world": "rooms", "world_size": (7, 7), "control_hz": 5.0, "robot": "turtlebot3_waffle_pi"}
    env = gymnasium.make(ROOMS["id"], observations=driver.observations, **room)
    episode = run_episode(env, driver, 0)
    assert episode.end_reason == "covered"
    assert episode.duration < 0.5 * episode.time_limit
    assert episode.collisions == 0


def test_the_policy_of_the_package_was_trained_by_the_recipe():
    data = {"experiment": "Explore-v0", "environment": {"id": "lidarnaut/Explore-v0"}}
    config = parse_record(with_recipe(data)[0], "recipe", TrainingConfig)
    record = load_checkpoint(find_policy("pretrained/twist"), policy_only=True).record
    # Seed, folder and number of threads have no effect on the settings; the network has been saved with its defaults.
    own = {name: getattr(record.config, name) for name in ("seed", "experiment", "torch_threads", "network")}
    assert record.config == config.model_copy(update=own)
    assert record.config.network.items() >= config.network.items()


@pytest.mark.parametrize("path", ["shortest", "plan"])
def test_a_policy_that_is_measured_with_ground_truth_is_marked_in_its_run_and_in_evaluations(tmp_path, path):
    parts = {name: {"goal": None, "carrot": {"path": name}} for name in ("shortest", "plan")}
    reach = {"world": "hall", "world_size": [6, 6], "robot": "jackal", "time_limit": 1.0, "num_workers": 0}
    reach |= {"id": "lidarnaut/ReachGoal-v0", "observations": parts["shortest"]}
    evaluation = {"every": 16, "episodes": 1, "references": ["pursuit", "tests.own_code:shown"]}
    evaluation["environment"] = {"observations": parts[path], "world": "hall"}
    config = tiny("PPO", "Explore", environment=reach, evaluation=evaluation)
    run = train(config, run=tmp_path / "run", progress=False)
    mark = " (ground truth)" if path == "shortest" else ""
    names = [row["policy"] for row in read_evaluations(run)]
    assert names[:2] == ["pursuit", f"tests.own_code:shown{mark}"]
    assert set(names[2:]) == {f"learned{mark}"}
    brief = {"id": reach["id"], "worlds": ("hall",), "robots": ("jackal",), "time_limit": 0.5, "episodes": 1}
    settings = Settings(policies=(f"ppo:{run}", f"mine=ppo:{run}"), **brief)
    evaluated = Evaluation(settings, tmp_path / "out", trust=["tests.own_code"])
    assert evaluated.run() == []
    assert [row["policy"] for row in evaluated.rows()] == [f"ppo:{run}{mark}", f"mine{mark}"]
    # Users of the policy see what its evaluations see: the true path may be missing there.
    policy = LearnedPolicy.load(run, trust="tests")
    assert policy.observations == parts[path]
    env = gymnasium.make(reach["id"], observations=policy.observations, world="hall", robot="jackal")
    policy.reset(env.unwrapped.robot_params, 0.1, np.random.default_rng(0))
    assert env.action_space.contains(policy(env.reset(seed=0)[0]))
    env.close()


def test_learned_policies_use_one_thread_and_leave_the_number_of_the_process(request, monkeypatch):
    request.addfinalizer(partial(torch.set_num_threads, torch.get_num_threads()))
    torch.set_num_threads(2)
    policy = make_policy("pretrained/reach")
    assert torch.get_num_threads() == 2
    used = []

    def act(batch, starts):
        used.append(torch.get_num_threads())
        return np.zeros((1, 2), np.float32)

    monkeypatch.setattr(policy, "_actor", act)
    with gymnasium.make(policy.id, physics="kinematic", **{**policy.arguments, "time_limit": 0.5}) as env:
        run_episode(env, policy, 0)
        monkeypatch.setattr(policy, "_actor", lambda batch, starts: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run_episode(env, policy, 0)
    assert set(used) == {1}
    assert torch.get_num_threads() == 2
