import gc
import math
import weakref

import gymnasium
import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.goals import GeodesicDistance
from lidarnaut.envs.worlds import BARN_NAMES, FAMILIES, explorable_area, load_world, world_sampler
from lidarnaut.envs.worlds.world import kept_with_world

JACKAL = load_robot("jackal")
STEP = 0.05


@pytest.mark.parametrize("family", ["clutter", "hall", "corridor", "doorway", "crossing"])
def test_the_robot_can_go_from_each_spawn_to_its_goal_on_the_other_side(family):
    for seed in range(30):
        world = FAMILIES[family](seed, None, JACKAL.radius)
        area = explorable_area(world, JACKAL, STEP)
        assert len(world.spawns) == len(world.goals) == {"clutter": 1, "crossing": 4}.get(family, 2)
        for spawn, goal in zip(world.spawns, world.goals):
            assert area.is_traversable(spawn)
            straight = math.dist(spawn[:2], goal[:2])
            assert straight <= GeodesicDistance(area, goal).length(spawn) + STEP < 2.0 * straight + 5.0
            ahead = spawn.between(goal)
            assert abs(math.atan2(ahead.y, ahead.x)) < 1e-9
            sides = np.abs(np.subtract(goal[:2], spawn[:2])) / np.subtract(world.bounds[2:], world.bounds[:2])
            assert sides.max() > (0.4 if family == "clutter" else 0.7)


def clearances(world):
    """Return distances to the nearest cylinder of points on a grid between start and goal [m]."""
    (x, y, _), (_, top, _) = world.spawns[0], world.goals[0]
    nodes = np.stack(np.meshgrid(np.arange(y, top, STEP), np.arange(x - 2.2, x + 2.2, STEP), indexing="ij"), axis=-1)
    return cKDTree(world.circles[:, 1::-1]).query(nodes)[0] - world.circles[0, 2]


def bottleneck(world):
    """Return the radius of the largest circle that fits through from start to goal [m]."""
    clearance, low, high = clearances(world), 0.0, 2.0
    middle = clearance.shape[1] // 2
    while high - low > 0.005:
        radius = 0.5 * (low + high)
        labels, _ = ndimage.label(clearance > radius)
        low, high = (radius, high) if labels[0, middle] == labels[-1, middle] > 0 else (low, radius)
    return low


def detour(world):
    area = explorable_area(world, JACKAL, STEP)
    return GeodesicDistance(area, world.goals[0]).length(world.spawns[0]) / (world.goals[0].y - world.spawns[0].y)


def test_clutter_resembles_the_worlds_of_barn():
    barn = [load_world(name) for name in BARN_NAMES[::4]]
    drawn = [FAMILIES["clutter"](seed) for seed in range(75)]
    quartiles = [25, 50, 75]
    gaps, ours = (np.percentile([bottleneck(world) for world in worlds], quartiles) for worlds in (barn, drawn))
    assert np.abs(ours - gaps).max() < 0.06, (ours, gaps)
    lengths, ours = (np.percentile([detour(world) for world in worlds], quartiles) for worlds in (barn, drawn))
    assert np.abs(ours - lengths).max() < 0.03, (ours, lengths)
    counts, ours = (np.median([len(world.circles) for world in worlds]) for worlds in (barn, drawn))
    assert ours == pytest.approx(counts, rel=0.1)


def test_difficult_clutter_is_narrower():
    easy, hard = ([bottleneck(FAMILIES["clutter"](s, None, 0.0, d)) for s in range(20)] for d in (0.0, 1.0))
    assert min(easy + hard) > 0.34
    assert np.mean(easy) > np.mean(hard) + 0.1


def test_environments_pass_on_radius_and_difficulty_but_not_to_worlds_of_options():
    env = gymnasium.make("lidarnaut/ReachGoal-v0", world="clutter", difficulty=1.0, robot="jackal")
    env.reset(seed=3)
    world = env.unwrapped.world
    again = FAMILIES["clutter"](int(world.name.partition("-")[2]), None, JACKAL.radius, 1.0)
    np.testing.assert_array_equal(world.circles, again.circles)
    env.reset(options={"world": "hall"})
    assert env.unwrapped.world.name.startswith("hall-")


def test_a_number_of_worlds_are_made_once_and_drawn_again():
    rng = np.random.default_rng(0)
    sample = world_sampler("hall", num_worlds=3, size=[8.0, 6.0])
    drawn = [sample(rng) for _ in range(40)]
    assert len({id(world) for world in drawn}) == 3
    assert {world.name for world in drawn} == {"hall-0", "hall-2", "hall-4"}
    assert world_sampler("hall", num_worlds=3, size=(8.0, 6.0))(np.random.default_rng(0)) is drawn[0]
    assert world_sampler("hall", num_worlds=3, split="test")(rng).name in ("hall-1", "hall-3", "hall-5")
    for number in (0, 1.5, "many"):
        with pytest.raises(ValueError, match="num_worlds must be a positive whole number or None"):
            world_sampler("hall", num_worlds=number)


def test_one_of_several_worlds_is_drawn():
    rng = np.random.default_rng(1)
    sample = world_sampler(["clutter", "hall", "turtlebot3_world"], size=(14.5, 23.0), difficulty=0.0, num_worlds=2)
    drawn = {world.name: world for world in (sample(rng) for _ in range(60))}
    assert set(drawn) == {"clutter-0", "clutter-2", "hall-0", "hall-2", "turtlebot3_world"}
    easy = FAMILIES["clutter"](0, (14.5, 23.0), 0.0, 0.0)
    np.testing.assert_array_equal(drawn["clutter-0"].circles, easy.circles)
    for worlds, complaint in (([], "empty list"), (["hall", "nowhere"], "nowhere")):
        with pytest.raises(ValueError, match=complaint):
            world_sampler(worlds)


def test_what_is_made_of_a_world_lives_as_long_as_it_does():
    calls = []
    count = kept_with_world(lambda world, number: calls.append(number) or number)
    world = world_sampler("hall")(np.random.default_rng(0))
    assert [count(world, 1), count(world, 2), count(world, 1)] == [1, 2, 1]
    assert calls == [1, 2]
    name = weakref.ref(world)
    del world
    gc.collect()
    assert name() is None
