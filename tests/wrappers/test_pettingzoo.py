import gymnasium
import numpy as np
import pytest

pytest.importorskip("pettingzoo", reason="pettingzoo is not installed")

from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.explore_team_frontiers import ExploreTeamFrontiersEnv
from lidarnaut.envs.tasks.explore import ExploreTeam
from lidarnaut.envs.wrappers.pettingzoo import TeamFrontiersAECEnv, TeamParallelEnv

QUICK = {"world": "turtlebot3_world", "physics": "kinematic", "time_limit": 2.0}


def test_the_api_is_that_of_pettingzoo_and_episodes_repeat():
    parallel_api_test(TeamParallelEnv(num_robots=3, **QUICK), num_cycles=50)
    parallel_seed_test(lambda: TeamParallelEnv(num_robots=2, **QUICK), num_cycles=5)


def test_agents_get_their_rows_of_the_team_environment():
    team, env = LidarEnv(ExploreTeam, num_robots=2, **QUICK), TeamParallelEnv(num_robots=2, **QUICK)
    team.reset(seed=3)
    env.reset(seed=3)
    rows = np.array([[0.5, 0.2], [1.0, -0.4]], dtype=np.float32)
    while env.agents:
        expected, reward, terminated, truncated, info = team.step(rows)
        observations, rewards, terminations, truncations, infos = env.step(dict(zip(env.agents, rows)))
        for k, agent in enumerate(env.possible_agents):
            assert env.observation_space(agent).contains(observations[agent])
            for name, part in expected.items():
                np.testing.assert_array_equal(observations[agent][name], part[k])
            assert rewards[agent] == reward
            assert (terminations[agent], truncations[agent]) == (terminated, truncated)
            assert infos[agent]["path_length"] == info["path_length"][k]
    assert truncated


def test_agents_of_decisions_act_in_turn_and_share_the_reward():
    arguments = {**QUICK, "world": "rooms", "world_size": (8.0, 8.0), "num_robots": 2, "time_limit": 20.0}
    api_test(TeamFrontiersAECEnv(**arguments), num_cycles=20)
    team, env = (make(**arguments) for make in (ExploreTeamFrontiersEnv, TeamFrontiersAECEnv))
    expected, info = team.reset(seed=3)
    env.reset(seed=3)
    owed, truncated = dict.fromkeys(env.agents, 0.0), False
    while not truncated:
        agent = f"robot_{info['robot']}"
        assert env.agent_selection == agent
        observation, reward, *_ = env.last()
        assert reward == pytest.approx(owed[agent])
        for name, part in expected.items():
            np.testing.assert_array_equal(observation[name], part)
        owed[agent] = 0.0
        expected, reward, _, truncated, info = team.step(np.int64(1))
        owed = {name: one + reward for name, one in owed.items()}
        env.step(np.int64(1))
    assert env.truncations == {"robot_0": True, "robot_1": True}


STILL = np.zeros(2, dtype=np.float32)


def test_wrong_calls_of_a_parallel_step_are_named():
    env = TeamParallelEnv(num_robots=2, **QUICK | {"time_limit": 0.2})
    right = dict.fromkeys(env.possible_agents, STILL)
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episode has begun"):
        env.step(right)
    env.reset(seed=0)
    for wrong in ({"robot_0": STILL}, right | {"robot_2": STILL}, {}, [STILL, STILL], None):
        with pytest.raises(ValueError, match=r"actions must map each of \['robot_0', 'robot_1'\] to its action, got"):
            env.step(wrong)
    for wrong in (np.zeros(3), None, 1.0, "ab"):
        with pytest.raises(ValueError, match=r"action of robot_1 must have shape \(2,\), got"):
            env.step(right | {"robot_1": wrong})
    with pytest.raises(ValueError, match="options must map names to values, got 5"):
        env.reset(options=5)
    env.step(right)
    _, _, _, truncations, _ = env.step(right)
    assert truncations == {"robot_0": True, "robot_1": True}
    for actions in (right, {}):
        with pytest.raises(gymnasium.error.ResetNeeded, match="all agents have ended"):
            env.step(actions)
    env.reset()
    env.step(right)


def test_wrong_decisions_are_named_and_cost_no_reward():
    env = TeamFrontiersAECEnv(num_robots=2, **QUICK | {"time_limit": 20.0})
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episode has begun"):
        env.step(np.int64(0))
    env.reset(seed=0)
    env.step(np.int64(0))
    env.step(np.int64(0))
    owed = env.last()[1]
    for wrong in (None, 1.7, -1, 10**6):
        with pytest.raises(ValueError, match="action must be an integer from 0 to"):
            env.step(wrong)
    assert env.last()[1] == owed != 0.0


def shared(first, second):
    if isinstance(first, np.ndarray):
        return np.shares_memory(first, second)
    return isinstance(first, dict) and (first is second or any(shared(first[key], second[key]) for key in first))


@pytest.mark.parametrize("kind", [TeamParallelEnv, TeamFrontiersAECEnv])
def test_infos_of_agents_share_nothing(kind):
    env = kind(num_robots=2, randomize={"lidar.noise_std": (0.01, 0.02)}, **QUICK)
    result = env.reset(seed=0)
    one = result[1] if result else env.infos
    assert not shared(one["robot_0"], one["robot_1"])
