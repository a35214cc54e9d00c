import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines import EXPLORERS, NearestExplorer, OracleExplorer, PrivilegedPolicy
from lidarnaut.baselines.episode import begin_episode, run_episode
from lidarnaut.baselines.oracle.oracle_explorer import TrueMap
from lidarnaut.baselines.policy import to_action
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.tasks.explore import Explore
from tests.baselines.oracle.test_cover_planner import corridor, world_of

CORRIDOR = corridor(8.0)


def make_env(world, slam="truth", **settings):
    return LidarEnv(Explore, world=world, robot="turtlebot3_burger", physics="kinematic", slam=slam, **settings)


def explore(explorer, world, seed=0, slam="truth", **settings):
    return run_episode(make_env(world, slam, **settings), explorer, seed)


def test_only_the_oracle_uses_ground_truth():
    omniscient = [name for name in EXPLORERS if isinstance(make_policy(name), PrivilegedPolicy)]
    assert omniscient == ["oracle"]


@pytest.mark.parametrize(
    ("world", "start", "length"),
    [
        # All but 1 %: 0.2 m of the far end. Seen from 3.5 m, the near end takes 4.6 m there and back, the other 8.4 m.
        (CORRIDOR, (8.0, 1.0, 0.0), pytest.approx(2 * 4.6 + 8.4, rel=0.06)),
        (CORRIDOR, (2.0, 1.0, 0.0), pytest.approx(14.5, rel=0.05)),
        (CORRIDOR, (2.0, 1.0, 2.5), pytest.approx(14.5, rel=0.05)),
        (world_of((0, 0), (3, 0), (3, 3), (0, 3), start=(1.5, 1.5)), "spawn", pytest.approx(0.0, abs=0.05)),
    ],
)
def test_it_drives_no_farther_than_it_must(world, start, length):
    episode = explore(OracleExplorer(), world, start=start)
    assert episode.success
    assert episode.collisions == 0
    assert episode.path_length == length


def test_its_path_is_shorter_than_that_of_an_explorer_without_the_map():
    explorers = OracleExplorer(), NearestExplorer()
    oracle, nearest = (explore(one, "maze", 1, "tinyslam", world_size=(8.0, 8.0)) for one in explorers)
    assert oracle.success
    assert oracle.distance_to_95 < 0.9 * nearest.distance_to_95
    assert oracle.time_to_99 < 0.9 * nearest.time_to_99


def test_what_the_tour_leaves_over_is_left_to_the_nearest_frontier():
    env, explorer = make_env(CORRIDOR, start=(8.0, 1.0, 0.0)), OracleExplorer()
    _, info = begin_episode(env, explorer, 0, np.random.default_rng(0))
    explorer.reveal(env.task.coverage, 0.5)
    while "end_reason" not in info and explorer.end_reason is None:
        *_, info = env.step(to_action(explorer.act(env.reading, env.belief), env.robot_params))
    assert info["explored_fraction"] >= 0.99


def test_a_map_is_completed_by_the_true_one_where_it_is_unknown():
    walls = OccupancyGrid(np.zeros((20, 40), dtype=np.int8), 0.1, (-1.0, -1.0))
    walls.data[:, 30] = 100
    # The map frame is rotated by 90 degrees: its x axis is the world's y axis.
    truth = TrueMap(walls, Pose2D(1.0, 0.0, np.pi / 2))
    unknown, estimated = (OccupancyGrid(np.full((10, 10), -1, dtype=np.int8), 0.1, (-0.5, -0.5)) for _ in range(2))
    estimated.data[2, 3] = 100
    completed = truth.complete(estimated)
    assert estimated.data[0, 0] == -1

    def at(x, y):
        return completed.data[tuple(completed.cells(np.array([x, y])))]

    # World (2.05, 0.35) is the wall; the estimated cell is in free space of the true map.
    assert at(0.35, -1.05) == 100
    assert at(0.35, -0.85) == 0
    assert at(*estimated.centers(np.array([2, 3]))) == 100
    assert (completed.data >= 0).all()
    assert completed.data.shape[0] >= 40
    # Without overlap, only the true map is left.
    far = OccupancyGrid(np.zeros((3, 3), dtype=np.int8), 0.1, (50.0, 50.0))
    np.testing.assert_array_equal(truth.complete(far).data, truth.complete(unknown).data)
