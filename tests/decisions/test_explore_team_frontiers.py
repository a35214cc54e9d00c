import gymnasium
import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.decisions.explore_team_frontiers import ExploreTeamFrontiersEnv
from tests.rollouts import rollout

ROOMS = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic"}


def test_robots_decide_one_after_the_other_at_the_start_and_then_whenever_one_is_due():
    env = ExploreTeamFrontiersEnv(**ROOMS, num_robots=3)
    _, info = env.reset(seed=0)
    turns, times = [info["robot"]], []
    for _ in range(30):
        *_, info = env.step(np.int64(0))
        turns.append(info["robot"])
        times.append(info["decision_time"])
    assert turns[:3] == [0, 1, 2]
    assert times[:2] == [0.0, 0.0]
    assert times[2] > 0.0
    assert set(turns[3:]) == {0, 1, 2}
    # At most the time of one robot's decision: the other robots drive on meanwhile.
    assert max(times) < 8.0


def test_what_another_robot_goes_to_is_no_gain_and_peers_tell_of_it():
    env = ExploreTeamFrontiersEnv(**ROOMS, num_robots=2, max_candidates=30)
    seen, _ = env.reset(seed=0)
    assert seen["peers"].shape == (7,)
    assert seen["peers"][4:].tolist() == [0.0, 0.0, 0.0]
    choice = int(seen["candidates"][:, 0].argmax())
    goal, pose = env.candidates["frontier"][choice].copy(), env.belief.pose
    seen, *_ = env.step(np.int64(choice))
    x, y, _ = env.belief.pose.between(pose)
    np.testing.assert_allclose(16.0 * seen["peers"][:2], (x, y), atol=1e-5)
    assert seen["peers"][4] == 1.0
    np.testing.assert_allclose(
        env.belief.pose.transform(16.0 * seen["peers"][None, 5:].astype(np.float64))[0], goal, atol=1e-5
    )
    gaps = np.hypot(*(env.candidates["frontier"] - goal).T)
    assert gaps.min() < 0.5
    assert seen["candidates"][gaps.argmin(), 0] < 0.5 * seen["candidates"][:, 0].max()


def test_policies_for_one_robot_explore_with_all_of_them():
    env = gymnasium.make("lidarnaut/ExploreTeamFrontiers-v0", num_robots=3, target_coverage=0.95, **ROOMS)
    episode = run_episode(env, make_policy("gain_over_cost"), 1)
    assert (episode.end_reason, episode.collisions) == ("covered", 0.0)
    assert min(truth.path_length for truth in env.unwrapped.explore.truths) > 2.0


def test_an_episode_ends_when_no_robot_has_a_frontier_left():
    # Some corners of this house stay unknown in episodes of any length.
    arguments = {"world": "turtlebot3_house", "physics": "kinematic", "slam": "odometry", "target_coverage": 1.0}
    env = ExploreTeamFrontiersEnv(num_robots=2, **arguments)
    observation, _, terminated, _, info = rollout(env, 0, 1000, lambda _: np.int64(0))[-1]
    assert (terminated, info["end_reason"]) == (True, "no_reachable_frontier")
    assert not observation["action_mask"].any()


def test_a_team_of_one_sees_no_peers_and_none_returns_home():
    assert "peers" not in ExploreTeamFrontiersEnv(**ROOMS, num_robots=1).observation_space.spaces
    with pytest.raises(ValueError, match="return_home"):
        ExploreTeamFrontiersEnv(**ROOMS, num_robots=1, return_home=True)
    with pytest.raises(ValueError, match="num_robots"):
        ExploreTeamFrontiersEnv(**ROOMS, num_robots=5)
