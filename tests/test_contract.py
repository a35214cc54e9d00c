"""What holds for every id and every task: Gymnasium's contract, seeds, copies, docstrings, what is refused."""

import itertools
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_checker import data_equivalence as same
from stable_baselines3.common.env_checker import check_env as check_sb3

import envs  # noqa: F401  (registers the environments)

IDS = [id for id in gymnasium.registry if id.startswith("lidarnaut/")]
ROOMS = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic"}
TASKS = {
    "Explore": {**ROOMS, "control_hz": 5.0},
    "ExploreTeam": {**ROOMS, "control_hz": 5.0, "num_robots": 3},
    "ExploreFrontiers": {**ROOMS, "world_size": (10.0, 10.0)},
    "Navigate": {"world": "turtlebot3_world", "physics": "kinematic"},
    "Track": {
        **{"world": "turtlebot3_world", "robot": "turtlebot3_burger", "physics": "kinematic", "control_hz": 5.0},
        **{"path": [[-2.0, -0.5], [-0.55, -0.55], [-0.55, 0.55], [-2.0, 0.5]], "map_resolution": 0.1},
    },
}
STILL = np.zeros(2, dtype=np.float32)
every_task = pytest.mark.parametrize("task", TASKS)


def make(task, **arguments):
    return gymnasium.make(f"lidarnaut/{task}-v0", disable_env_checker=True, **TASKS[task] | arguments)


def rollout(env, seed, steps):
    """Drive with sampled actions; return everything that comes out."""
    env.action_space.seed(seed)
    out = [env.reset(seed=seed)]
    while len(out) <= steps and not (len(out) > 1 and (out[-1][2] or out[-1][3])):
        out.append(env.step(env.action_space.sample()))
    return out


@pytest.mark.parametrize(("id", "physics"), [*((id, "kinematic") for id in IDS), ("lidarnaut/Explore-v0", "bullet")])
def test_both_checkers_have_no_complaint(id, physics):
    env = gymnasium.make(id, physics=physics, time_limit=30.0, render_mode="rgb_array", disable_env_checker=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=id.removeprefix("lidarnaut/").removesuffix("-v0") not in TASKS)
        # A remark on rows of candidates, robots and route points: they are for a network of one's own, as it says.
        warnings.filterwarnings("ignore", message="Your observation .* has an unconventional shape .*neither an image")
        check_sb3(env.unwrapped)
    env.close()


@pytest.mark.parametrize("physics", ["bullet", "kinematic"])
@every_task
def test_same_seed_same_bytes_in_copies_too(task, physics):
    env, other = (make(task, physics=physics, render_mode="rgb_array") for _ in range(2))
    steps = 4 if task == "ExploreFrontiers" else 20
    first = rollout(env, 7, steps)
    env.render()
    for each in (env, other, pickle.loads(pickle.dumps(env)), gymnasium.make(EnvSpec.from_json(env.spec.to_json()))):
        assert same(first, rollout(each, 7, steps))
        each.reset(seed=8)
    assert not same(first, rollout(other, 9, steps))
    env.close()
    other.close()


@every_task
def test_a_copy_goes_on_where_its_original_was(task):
    env = make(task)
    rollout(env, 1, 3)
    copy, action = pickle.loads(pickle.dumps(env)), env.action_space.sample()
    assert same(env.step(action), copy.step(action))


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
    lines = (env if task == "ExploreFrontiers" else env.task).__doc__.splitlines()
    spaces = dict(line.split("`")[1::2][:2] for line in lines if line.strip().startswith("| `") and "(" in line)
    names = {"num_beams": 360, "num_robots": 3, "max_candidates": 48, "float32": np.float32, "uint8": np.uint8}
    names |= {"Box": lambda low, high, shape, dtype: gymnasium.spaces.Box(low, high, shape, dtype)}
    for key, space in env.observation_space.spaces.items():
        assert eval(spaces[key], names | {"MultiBinary": gymnasium.spaces.MultiBinary}) == space


NO_NUMBERS = (STILL.astype(complex), np.ma.masked_array(STILL, [True, False]), ["0.5", "0.5"], [None, 0.0], [True] * 2)


@pytest.mark.parametrize("action", NO_NUMBERS)
def test_actions_that_are_no_real_numbers_are_refused(action):
    env, vector = make("Explore"), gymnasium.make_vec("lidarnaut/Explore-v0", 1, num_workers=0, **TASKS["Explore"])
    for each, given in ((env, action), (vector, [action] if isinstance(action, list) else action[None])):
        each.reset(seed=0)
        with pytest.raises(ValueError, match="action must hold real numbers, got"):
            each.step(given)
        each.close()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.5, None])
@pytest.mark.parametrize("task", [task for task in TASKS if task != "ExploreFrontiers"])
def test_bad_actions_are_refused(task, value):
    env = make(task).unwrapped
    env.reset(seed=0)
    shape = env.action_space.shape
    with pytest.raises(ValueError, match="action must"):
        env.step(np.zeros((1, *shape)) if value is None else np.full(shape, value))
