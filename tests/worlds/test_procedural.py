import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import FAMILIES, check_world, explorable_area, free_area, reachable, world_sampler

SMALLEST = {
    **{"rooms": (4.0, 4.0), "maze": (3.0, 3.0), "warehouse": (6.0, 6.0), "caves": (4.0, 4.0), "wings": (7.0, 7.0)},
    **{"halls": (4.0, 4.0), "clutter": (12.0, 21.0), "hall": (5.0, 5.0), "corridor": (4.2, 4.2)},
    **{"doorway": (5.5, 3.5), "crossing": (7.0, 7.0)},
}
MORE = {"clutter": ((16.0, 24.0), (13.35, 25.05))}


@pytest.mark.parametrize("family", FAMILIES)
def test_forty_worlds_are_closed_and_fit_for_a_robot(family):
    generate = FAMILIES[family]
    outlines = set()
    for seed in range(40):
        size = (None, SMALLEST[family], *MORE.get(family, ((10.0, 10.0), (9.35, 14.05))))[seed % 4]
        world = check_world(generate(seed, size))
        if size is not None:
            assert world.bounds == pytest.approx((0.0, 0.0, *size), abs=1e-6)
        _, inside = reachable(world)
        grid, traversable = reachable(world, radius=0.25)
        clearance = ndimage.distance_transform_edt(grid.data == 0) * grid.resolution
        fitting = np.count_nonzero((clearance > 0.25) & inside)
        # Only single cells near furniture are missing.
        assert np.count_nonzero(traversable) > 0.93 * fitting, seed
        assert np.count_nonzero(inside) > 0.3 * grid.data.size, seed
        assert not world.people
        assert world.segments.flags.c_contiguous
        assert world.circles.flags.c_contiguous, "or all kernels would be compiled again"
        if size is None:
            outlines.add(world.segments.tobytes() + world.circles.tobytes())
    assert len(outlines) == 10


@pytest.mark.parametrize("family", FAMILIES)
def test_same_seed_same_bytes(family):
    for size in (None, SMALLEST[family]):
        first, again, other = (FAMILIES[family](seed, size) for seed in (5, 5, 6))
        assert pickle.dumps(first) == pickle.dumps(again)
        assert pickle.dumps(replace(other, name=first.name)) != pickle.dumps(first)
        assert first.name == f"{family}-5"


@pytest.mark.parametrize("family", FAMILIES)
def test_splits_draw_from_disjoint_seeds(family):
    seeds = {}
    for split in ("train", "validation", "test"):
        rng = np.random.default_rng(0)
        sample = world_sampler(family, split=split, size=SMALLEST[family])
        seeds[split] = [int(sample(rng).name.split("-")[1]) for _ in range(5)]
        assert len(set(seeds[split])) == 5
    assert {seed % 2 for seed in seeds["train"]} == {0}
    assert {seed % 2 for seed in seeds["test"]} == {1}
    assert max(seeds["train"] + seeds["test"]) < 2**32 <= min(seeds["validation"])


@pytest.mark.parametrize("family", FAMILIES)
def test_worlds_fit_their_robot_or_are_refused(family):
    for size in ((2.0, 10.0), (1e9, 10.0), (float("nan"), 5.0), (10.0,), 5.0, ("a", 5.0)):
        with pytest.raises(ValueError, match="size must be"):
            FAMILIES[family](0, size)
    with pytest.raises(ValueError, match="for a robot of a radius of"):
        FAMILIES["rooms"](0, (4.5, 4.5), 0.5)
    tugbot, burger = load_robot("tugbot"), load_robot("turtlebot3_burger")
    for seed in range(3):
        size = (30.0, 26.0)
        world = FAMILIES[family](seed, size, tugbot.radius)
        assert np.subtract(world.bounds[2:], world.bounds[:2]) == pytest.approx(size, abs=0.2)
        area, free = explorable_area(world, tugbot, 0.1).area, free_area(world)
        assert area > 0.85 * free
        # Worlds that fit a small robot are unchanged.
        assert pickle.dumps(FAMILIES[family](seed, size, burger.radius)) == pickle.dumps(FAMILIES[family](seed, size))
