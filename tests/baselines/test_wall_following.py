"""The wall follower, between walls drawn by hand."""

import numpy as np
import pytest

from baselines import WallFollower
from tests.baselines.maps import BURGER, reading_of


def reading_of_walls(*, right=np.inf, ahead=np.inf, yaw_rate=0.0):
    """What a burger sees between a wall parallel to its path and one across it [m]."""
    angles = BURGER.lidar.angles
    with np.errstate(divide="ignore"):
        to_right = np.where(np.sin(angles) < 0, right / -np.sin(angles), np.inf)
        to_front = np.where(np.cos(angles) > 0, ahead / np.cos(angles), np.inf)
    ranges = np.fmin(to_right, to_front)
    return reading_of(ranges=np.where(ranges > BURGER.lidar.range_max, np.inf, ranges), yaw_rate=yaw_rate)


def wall_follower(*, following):
    explorer = WallFollower()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    if following:
        explorer.act(reading_of_walls(ahead=0.4, right=0.25), None)
    return explorer


def test_the_wall_follower_drives_straight_on_to_a_wall_and_turns_left_there():
    assert wall_follower(following=False).act(reading_of_walls(), None).w == 0.0
    assert wall_follower(following=False).act(reading_of_walls(ahead=0.3, right=0.25), None).w > 0.0


def test_the_wall_follower_stays_beside_its_wall_and_turns_right_where_it_ends():
    explorer = wall_follower(following=True)
    along = explorer.act(reading_of_walls(right=0.3), None)
    assert along.v > 0.3 * BURGER.max_v
    assert abs(along.w) < 0.2 * BURGER.max_w
    assert explorer.act(reading_of_walls(right=1.5), None).w < 0.0


def test_the_wall_follower_leaves_a_pillar_that_it_has_been_round():
    explorer = wall_follower(following=True)
    turn, period = 0.3 * BURGER.max_w, 0.1
    steps = 0
    while explorer.act(reading_of_walls(right=1.5, yaw_rate=-turn), None).w <= 0.0:
        steps += 1
        assert steps < 200
    # It turns away to the left when it leaves.
    assert steps == pytest.approx(2.0 * np.pi / (turn * period), abs=2)
