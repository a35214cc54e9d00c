import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines import WallFollower
from lidarnaut.baselines.policy import to_action
from lidarnaut.envs.geometry import Pose2D
from tests.baselines.maps import BURGER, reading_of


def reading_of_walls(*, right=np.inf, ahead=np.inf, heading=0.0):
    """Reading of a burger between a wall parallel to its path and a wall across it [m]."""
    angles = BURGER.lidar.angles
    with np.errstate(divide="ignore"):
        to_right = np.where(np.sin(angles) < 0, right / -np.sin(angles), np.inf)
        to_front = np.where(np.cos(angles) > 0, ahead / np.cos(angles), np.inf)
    ranges = np.fmin(to_right, to_front)
    reading = reading_of(ranges=np.where(ranges > BURGER.lidar.range_max, np.inf, ranges))
    return reading._replace(odometry=Pose2D(0.0, 0.0, heading))


def wall_follower(*, following):
    explorer = WallFollower()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    if following:
        explorer.act(reading_of_walls(ahead=0.4, right=0.25), None)
    return explorer


def test_the_wall_follower_drives_to_a_wall_turns_left_and_stays_beside_it_until_it_ends():
    assert wall_follower(following=False).act(reading_of_walls(), None).w == 0.0
    assert wall_follower(following=False).act(reading_of_walls(ahead=0.3, right=0.25), None).w > 0.0
    explorer = wall_follower(following=True)
    along = explorer.act(reading_of_walls(right=0.3), None)
    assert along.v > 0.3 * BURGER.max_v
    assert abs(along.w) < 0.2 * BURGER.max_w
    assert explorer.act(reading_of_walls(right=1.5), None).w < 0.0


def test_the_wall_follower_leaves_a_pillar_that_it_has_been_round():
    explorer = wall_follower(following=True)
    turn, period, steps = 0.3 * BURGER.max_w, 0.1, 0
    while explorer.act(reading_of_walls(right=1.5, heading=-turn * period * steps), None).w <= 0.0:
        steps += 1
        assert steps < 200
    # The robot turns to the left when it leaves.
    assert steps == pytest.approx(2.0 * np.pi / (turn * period), abs=2)


def test_random_covers_the_action_space_and_follows_its_generator():
    explorer = make_policy("random")
    draws = []
    for seed in (0, 0, 1):
        explorer.reset(BURGER, 0.1, np.random.default_rng(seed))
        draws.append(np.array([to_action(explorer.act(None, None), BURGER) for _ in range(2000)]))
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])
    assert draws[0].dtype == np.float32
    counts, _, _ = np.histogram2d(*draws[0].T, bins=4, range=[[-1, 1], [-1, 1]])
    assert counts.min() > 80
    assert counts.sum() == 2000


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'teleporter'.*random, nearest, frontier"):
        make_policy("teleporter")
