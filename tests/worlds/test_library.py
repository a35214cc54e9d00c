from pathlib import Path

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import FAMILIES, WORLD_NAMES, World, free_area, load_world, reachable, world_sampler

# Size and free area (flood fill at 0.05 m), measured independently from the sources of the worlds.
MEASURED = {
    "aws_bookstore": (15.7, 14.62, 160.4),
    "aws_small_house": (19.0, 11.4, 155.9),
    "create3_maze": (20.02, 20.02, 276.6),
    "explorebench_corner": (20.18, 20.15, 283.9),
    "explorebench_corridor": (20.15, 20.15, 272.6),
    "explorebench_loop": (20.15, 20.15, 190.4),
    "rrt_MTR": (11.56, 11.44, 68.5),
    "rrt_house": (14.52, 14.63, 185.4),
    "tugbot_warehouse": (30.0, 50.0, 1260.0),
    "turtlebot3_dqn_stage1": (5.0, 5.0, 21.4),
    "turtlebot3_dqn_stage2": (5.0, 5.0, 21.1),
    "turtlebot3_dqn_stage4": (5.0, 5.0, 20.0),
    "turtlebot3_stage_1": (4.0, 4.0, 13.3),
    "turtlebot3_stage_2": (4.0, 4.0, 13.0),
    "turtlebot3_stage_4": (5.0, 5.0, 19.9),
    "turtlebot3_world": (7.97, 6.8, 20.0),
}


@pytest.mark.parametrize("name", WORLD_NAMES)
def test_every_world_loads_and_has_room_at_its_spawns(name):
    world = load_world(name)
    assert world.source
    assert world.licence
    assert load_world(name) is world_sampler(name)(np.random.default_rng(0)) is world
    if name in MEASURED:
        width, height, area = MEASURED[name]
        x_min, y_min, x_max, y_max = world.bounds
        assert (x_max - x_min, y_max - y_min) == pytest.approx((width, height), abs=0.02)
        assert free_area(world) == pytest.approx(area, rel=0.02)
    small = name in ("pimouse_arena", "raspimouse_sample_maze")
    radius, resolution = (0.08, 0.002) if small else (0.11, 0.02)
    grid, traversable = reachable(world, resolution, radius)
    assert all(traversable[tuple(grid.cells(np.array(spawn[:2])))] for spawn in world.spawns)


def test_people_keep_clear_of_walls():
    for name in WORLD_NAMES:
        world = load_world(name)
        grid, free = reachable(world, resolution=0.02)
        for person in world.people:
            ends = np.roll(person.waypoints, -1, axis=0)
            for share in np.linspace(0.0, 1.0, 100):
                assert free[tuple(grid.cells(person.waypoints + share * (ends - person.waypoints)).T)].all(), name


def test_worlds_of_the_users_own_by_module_and_attribute(tmp_path, monkeypatch):
    (tmp_path / "yard_of_mine.py").write_text(
        "from lidarnaut.envs.worlds import FAMILIES, load_world\n"
        "hall = load_world('turtlebot3_world')\n"
        "def maze(rng):\n    return FAMILIES['maze'](int(rng.integers(9)), (4.0, 4.0))\n"
        "number = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    hall = load_world("turtlebot3_world")
    assert load_world("yard_of_mine:hall") is hall
    sample, rng = world_sampler("yard_of_mine:maze"), np.random.default_rng(0)
    names = {sample(rng).name for _ in range(6)}
    assert len(names) > 1
    assert all(name.startswith("maze-") for name in names)
    with pytest.raises(ValueError, match=r"world 'yard_of_mine:number' must name a World.* got 3"):
        world_sampler("yard_of_mine:number")
    with pytest.raises(TypeError, match=r"lambda.* must return a World, got NoneType"):
        world_sampler(lambda rng: None)(np.random.default_rng(0))
    with pytest.raises(ValueError, match="no attribute 'halls'"):
        load_world("yard_of_mine:halls")


OPEN = World("open", np.array([[0.0, 0, 1, 0]]), np.empty((0, 3)), (Pose2D(0.5, 0.5, 0),), (0, 0, 1, 1))


@pytest.mark.parametrize(
    ("world", "options", "complaint"),
    [
        ("turtlebot_world", {}, r"'turtlebot_world' \(did you mean 'turtlebot3_world'\?\).*aws_small_house.*caves"),
        ("rooms", {"split": "dev"}, "'train', 'validation', 'test'"),
        ("turtlebot3_world", {"size": (5.0, 5.0)}, r"turtlebot3_world.*has a fixed size"),
        ("barn:3", {"size": (20.0, 20.0)}, "'barn:3' has a fixed size"),
        *((f"barn:{k}", {}, rf"'barn:{k}'.*barn:0 to barn:299") for k in (300, -1, "office")),
        ("rooms", {"size": (-3.0, 5.0)}, r"from 4 x 4 m to 200 x 200 m"),
        ("hall", {"difficulty": 0.5}, "difficulty applies to the family 'clutter' only, not to 'hall'"),
        ("barn:1", {"difficulty": 0.5}, "only, not to 'barn:1'"),
        ("clutter", {"difficulty": 1.5}, r"must lie in \[0, 1\], got 1\.5"),
        (OPEN, {}, "leaks"),
    ],
)
def test_sampler_refuses_unknown_arguments(world, options, complaint):
    with pytest.raises(ValueError, match=complaint):
        world_sampler(world, **options)


def test_the_page_about_worlds_names_them_all():
    page = (Path(__file__).parents[2] / "docs/concepts/worlds.md").read_text()
    assert [name for name in (*WORLD_NAMES, *FAMILIES) if f"`{name}`" not in page] == []
