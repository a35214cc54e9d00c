import copy

import gymnasium
import numpy as np

from lidarnaut.envs.worlds.world import FixedRoute
from tests.rooms import square_room

ROUTES = [
    FixedRoute(0.2, np.array([(-2.5, 1.0), (2.5, 1.2)]), 0.8),
    FixedRoute(0.25, np.array([(-2.5, -1.0), (2.5, -2.5), (0.0, -2.0)]), 1.1),
    FixedRoute(0.25, np.array([(2.0, 2.5), (-2.0, 2.2)]), 0.6),
]
WORLD = square_room(3.2, circles=[(1.5, 0.0, 0.15)], people=ROUTES)
KEYS = {"world": WORLD, "slam": "truth", "observations": ("tracks", "motion")}


def drive(env, steps):
    return [env.step(np.array([0.3, 0.4 * (-1) ** (k // 30)], dtype=np.float32))[0]["tracks"] for k in range(steps)]


def test_tracks_are_people_near_the_robot_and_equal_in_copies():
    env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", **KEYS).unwrapped
    assert env.observation_space["tracks"].shape == (40,)
    env.reset(seed=1)
    first = drive(env, 60)
    twin = copy.deepcopy(env)
    second = drive(env, 60)
    np.testing.assert_array_equal(second, drive(twin, 60))
    env.reset(seed=1)
    np.testing.assert_array_equal(first, drive(env, 60))
    rows = np.array(first + second).reshape(-1, 8, 5)
    shown = rows[np.abs(rows).sum(axis=2) > 0.0]
    assert len(shown) > 50
    assert (np.abs(rows) <= 1.0).all()
    distances = np.hypot(rows[:, :2, 0], rows[:, :2, 1])
    both = distances[:, 1] > 0.0
    assert (distances[both, 0] <= distances[both, 1]).all()


def test_people_stay_out_of_maps_and_who_was_drawn_before_fades():
    ghosts, found = {}, False
    for track in (False, True):
        keys = KEYS | {"observations": ("scan",), "slam": "hector"}
        env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", track_people=track, **keys)
        env.reset(seed=3, options={"start": (0.0, 0.0, 0.0)})
        ghosts[track] = 0
        for k in range(300):
            env.step(np.array([0.0, 0.5], dtype=np.float32))
            if k > 120:
                ghosts[track] += count_ghosts(env.unwrapped)
            assert track == (env.unwrapped.belief.on_people is not None)
            found |= track and env.unwrapped.belief.on_people.any()
        assert (env.unwrapped.robots[0].tracker is not None) == track
    assert found
    assert ghosts[False] > 1000
    assert ghosts[True] < 0.05 * ghosts[False]


def test_people_are_tracked_by_robots_with_a_map_unless_it_is_refused():
    tracks = {("hector", None): True, ("odometry", None): False, ("hector", False): False, ("odometry", True): True}
    for (slam, wanted), expected in tracks.items():
        arguments = {"people": 2, "physics": "kinematic", "slam": slam, "track_people": wanted}
        env = gymnasium.make("lidarnaut/ReachGoal-v0", **arguments).unwrapped
        assert (env.robots[0].tracker is not None) == expected


def count_ghosts(env):
    grid = env.belief.grid
    x, y = env.map_pose.transform(grid.centers(np.argwhere(grid.data > 50))).T
    return (np.maximum(abs(x), abs(y)) < 3.0)[np.hypot(x - 1.5, y) > 0.4].sum()
