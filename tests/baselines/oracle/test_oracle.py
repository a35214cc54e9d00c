"""The explorer that has the true map: shortest paths through small worlds, and no ground truth for the others."""

import gymnasium
import numpy as np
import pytest

import envs  # noqa: F401
from baselines import EXPLORERS, NearestExplorer, Omniscient, OracleExplorer, make_explorer
from baselines.episode import begin_episode, run_episode
from baselines.explorer import to_action
from baselines.oracle.explorer import TrueMap
from envs.geometry import OccupancyGrid, Pose2D
from tests.baselines.maps import BURGER, belief_at, reading_of
from tests.baselines.oracle.test_cover_planner import world_of

CORRIDOR = world_of((0, 0), (20, 0), (20, 2), (0, 2), start=(8.0, 1.0))


def explore(explorer, world, seed=0, slam="truth", **settings):
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world=world, robot="turtlebot3_burger", physics="kinematic", slam=slam, **settings
    )
    episode = run_episode(env, explorer, seed)
    env.close()
    return episode


def test_only_the_oracle_uses_ground_truth():
    omniscient = [name for name in EXPLORERS if isinstance(make_explorer(name), Omniscient)]
    assert omniscient == ["oracle"]


def test_an_oracle_without_ground_truth_says_what_is_missing():
    explorer = OracleExplorer()
    with pytest.raises(RuntimeError, match="reveal"):
        explorer.act(reading_of(), belief_at(0.0, 0.0))
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    with pytest.raises(RuntimeError, match="reveal"):
        explorer.act(reading_of(), belief_at(0.0, 0.0))


def test_in_a_corridor_it_drives_to_the_near_end_first_and_no_farther_than_it_must():
    # All but 1 %: 0.2 m of the far end. Seen from 3.5 m, the near end takes 4.6 m there and back, the other 8.4 m.
    episode = explore(OracleExplorer(), CORRIDOR, start=(8.0, 1.0, 0.0))
    assert episode.success
    assert episode.collisions == 0
    assert episode.path_length == pytest.approx(2 * 4.6 + 8.4, rel=0.06)


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_in_a_corridor_with_its_start_near_an_end_it_drives_to_the_other(heading):
    episode = explore(OracleExplorer(), CORRIDOR, start=(2.0, 1.0, heading))
    assert episode.success
    assert episode.path_length == pytest.approx(14.5, rel=0.05)


def test_what_is_seen_from_the_start_takes_no_path():
    episode = explore(OracleExplorer(), world_of((0, 0), (3, 0), (3, 3), (0, 3), start=(1.5, 1.5)), start="spawn")
    assert episode.success
    assert episode.path_length < 0.05


def test_the_same_seed_drives_the_same_path():
    courses = [explore(OracleExplorer(), "rooms", 3, "tinyslam", world_size=(6.0, 6.0)).course for _ in range(2)]
    for name in ("time", "path_length", "explored_fraction"):
        np.testing.assert_array_equal(courses[0].of(name), courses[1].of(name))


@pytest.mark.parametrize(("world", "seed", "slam"), [("maze", 1, "tinyslam"), ("rooms", 2, "truth")])
def test_its_path_is_shorter_than_that_of_an_explorer_without_the_map(world, seed, slam):
    oracle, nearest = (
        explore(explorer, world, seed, slam, world_size=(8.0, 8.0))
        for explorer in (OracleExplorer(), NearestExplorer())
    )
    assert oracle.success
    assert oracle.distance_to_95 < 0.9 * nearest.distance_to_95
    assert oracle.time_to_99 < 0.9 * nearest.time_to_99


def test_what_the_tour_leaves_over_is_left_to_the_nearest_frontier():
    # The plan is for half of the world, the episode for nearly all.
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world=CORRIDOR, robot="turtlebot3_burger", physics="kinematic", slam="truth",
        start=(8.0, 1.0, 0.0),
    )  # fmt: skip
    unwrapped, explorer = env.unwrapped, OracleExplorer()
    _, info = begin_episode(env, explorer, 0, np.random.default_rng(0))
    explorer.reveal(unwrapped.task.coverage, 0.5)
    while "end_reason" not in info and explorer.end_reason is None:
        *_, info = env.step(to_action(explorer.act(unwrapped.reading, unwrapped.belief), unwrapped.robot))
    env.close()
    assert info["explored_fraction"] >= 0.99


def test_a_map_is_completed_by_the_true_one_where_it_is_unknown():
    walls = OccupancyGrid(np.zeros((20, 40), dtype=np.int8), 0.1, (-1.0, -1.0))
    walls.data[:, 30] = 100
    # The map frame is turned by a right angle: its x axis is the world's y axis.
    truth = TrueMap(walls, Pose2D(1.0, 0.0, np.pi / 2))
    estimated = OccupancyGrid(np.full((10, 10), -1, dtype=np.int8), 0.1, (-0.5, -0.5))
    estimated.data[2, 3] = 100
    completed = truth.complete(estimated)
    assert estimated.data[0, 0] == -1

    def at(x, y):
        return completed.data[tuple(completed.cells(np.array([x, y])))]

    # World (2.05, 0.35) is the wall; the estimated cell lies where the true map is free.
    assert at(0.35, -1.05) == 100
    assert at(0.35, -0.85) == 0
    assert at(*estimated.centers(np.array([2, 3]))) == 100
    assert (completed.data >= 0).all()
    assert completed.data.shape[0] >= 40
    # Without anything in common, only the true map is left.
    far = OccupancyGrid(np.zeros((3, 3), dtype=np.int8), 0.1, (50.0, 50.0))
    assert (
        truth.complete(far).data == truth.complete(OccupancyGrid(estimated.data * 0 - 1, 0.1, (-0.5, -0.5))).data
    ).all()
