"""Maps of other programs as worlds: the robot starts in the house, and the house is the world."""

import logging

import numpy as np
import pytest
import yaml
from PIL import Image, ImageFilter

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import free_area, load_map, load_world
from lidarnaut.envs.worlds.map_worlds import class_at, left_out

UNKNOWN, FREE, WALL = 0, 1, 2
HOUSE = (2.0, 1.5, 8.0, 6.5)
"""x_min, y_min, x_max, y_max of the inside [m]; the map begins at (0, 0)."""


def house(beyond=UNKNOWN, yard=0.0):
    """Classes of a map of 11 m x 9 m in cells of 0.05 m, top row first: two rooms and a door between them.

    `beyond`: class around the house; `yard`: width of free space seen through a window above the house [m].
    """
    cells = np.full((180, 220), beyond)
    cells[28:132, 38:162] = WALL
    cells[30:130, 40:160] = FREE
    cells[30:130, 108:110] = WALL
    cells[60:80, 108:110] = FREE
    cells[90:96, 60:70] = WALL
    if yard:
        cells[132 : 132 + round(yard / 0.05), 2:218] = FREE
    return cells[::-1]


def save(folder, image, name="map.pgm", **changes):
    image = image if isinstance(image, Image.Image) else Image.fromarray(image)
    image.save(folder / name)
    content = {"image": name, "resolution": 0.05, "origin": [0.0, 0.0, 0.0], "negate": 0}
    content |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | changes
    (folder / "map.yaml").write_text(yaml.safe_dump(content))


def greys(cells, unknown=205, free=254, wall=0):
    return np.array([unknown, free, wall], dtype=np.uint8)[cells]


def retouched():
    pixels = greys(house())
    pixels[80:90, 70:80] = 255  # a chair is painted over, a line is drawn with a soft brush
    pixels[140, 60:70] = (60, 120, 200, 230, 251) * 2
    return pixels


def probabilities():
    rng, cells = np.random.default_rng(0), house()
    pixels = greys(cells, 128, 240, 20).astype(np.int64)
    pixels[cells == FREE] += rng.integers(-25, 15, np.count_nonzero(cells == FREE))
    pixels[cells == WALL] += rng.integers(-20, 60, np.count_nonzero(cells == WALL))
    return pixels.clip(0, 255).astype(np.uint8)


def drawn_by_hand():
    image = Image.fromarray(greys(house(beyond=FREE), free=255)).resize((880, 720), Image.Resampling.NEAREST)
    return image.filter(ImageFilter.GaussianBlur(1.0)).resize((220, 180), Image.Resampling.BILINEAR)


def rgba(grey, alpha):
    return np.dstack([grey, grey, grey, np.broadcast_to(alpha, grey.shape)]).astype(np.uint8)


GREY, INSIDE = greys(house()), np.where(house() == UNKNOWN, 0, 255)
FEW_ERASED = np.pad(np.zeros((5, 5)), ((5, 170), (5, 210)), constant_values=255)
LOOSE = {"free_thresh": 0.25}
STYLES = {
    "map_saver of ROS 1": (GREY, "map.pgm", {}),
    "map_saver of Nav2": (GREY, "map.pgm", {"mode": "trinary", **LOOSE}),
    "map_saver of Nav2, retouched": (retouched(), "map.png", {"mode": "trinary", **LOOSE}),
    "slam_toolbox with a yard": (greys(house(yard=2.0)), "map.pgm", LOOSE),
    "Cartographer": (probabilities(), "map.pgm", {}),
    "floor plan by hand": (drawn_by_hand(), "plan.png", {}),
    "floor plan as photograph": (greys(house(beyond=FREE), free=250, wall=8), "plan.jpg", LOOSE),
    "floor plan, white on black": (255 - greys(house(beyond=FREE), free=255), "plan.bmp", {"negate": 1}),
    "GIMP with an erased outside": (rgba(greys(house(), unknown=255), INSIDE), "map.png", {}),
    "GIMP with an alpha channel": (rgba(GREY, 255), "map.png", LOOSE),
    "GIMP, indexed": (Image.fromarray(GREY).convert("RGB").quantize(4), "map.png", LOOSE),
    "GIMP with an eraser in a saved map": (rgba(GREY, FEW_ERASED), "map.png", LOOSE),
    "16 bits": (257 * GREY.astype(np.uint16), "map.png", LOOSE),
    "scale of Nav2": (rgba(greys(house(), 0, 255, 0), INSIDE)[..., 2:], "map.png", {"mode": "scale", **LOOSE}),
}


def load(folder, style):
    image, name, changes = STYLES[style]
    save(folder, image, name, **changes)
    if style == "map_saver of ROS 1":
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content.replace(b"P5\n", b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n", 1))
    return load_world(folder / "map.yaml")


def assert_starts_inside(world):
    x, y, _ = world.spawns[0]
    assert HOUSE[0] < x < HOUSE[2]
    assert HOUSE[1] < y < HOUSE[3]


@pytest.mark.parametrize("style", STYLES)
def test_the_house_is_the_world(tmp_path, style):
    world = load(tmp_path, style)
    assert_starts_inside(world)
    assert world.bounds == pytest.approx(HOUSE, abs=0.11)
    assert free_area(world) == pytest.approx(6.0 * 5.0 - 0.65, rel=0.06)


def test_robots_start_indoors_where_a_door_is_open(tmp_path):
    cells = house(beyond=FREE)
    cells[90:110, 36:42] = FREE
    save(tmp_path, greys(cells, free=255), "plan.png")
    assert_starts_inside(load_world(tmp_path / "map.yaml"))


def test_the_log_names_area_spawn_and_the_rest(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    world = load(tmp_path, "slam_toolbox with a yard")
    assert "free_thresh 0.25 classifies grey 205 as free; it is read as unknown" in caplog.text
    assert "world of map map: 29.5 m2 around the spawn" in caplog.text
    assert "left out: 21.6 m2 in 1 other areas" in caplog.text
    assert (left_out(world).data == 100).sum() * 0.05**2 == pytest.approx(21.6)
    caplog.clear()
    load(tmp_path, "floor plan by hand")
    warned = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert any("m2 in 1 other areas" in text for text in warned)


def test_a_start_chooses_the_area(tmp_path):
    inside, path, outside = load(tmp_path, "floor plan by hand"), str(tmp_path / "map.yaml"), (0.6, 4.0, 0.0)
    plan = {"world": path, "physics": "kinematic"}
    for arguments, options in (({}, {"start": outside}), ({"start": outside}, {})):
        env = LidarEnv(Explore, **plan, slam="truth", **arguments)
        env.reset(seed=0, options=options)
        assert tuple(env.simulator.states[0].pose) == pytest.approx(outside)
        assert env.task.area.area == pytest.approx(11.0 * 9.0 - 6.2 * 5.2, rel=0.1)
        again = env.world
        env.reset(seed=1, options=options)
        assert env.world is again
    env = LidarEnv(Navigate, **plan, localizer="truth", start=(3.0, 3.0, 0.0), goal=(7.0, 3.0, 0.0))
    env.reset(seed=0)
    assert env.world is inside


@pytest.mark.parametrize(
    ("start", "where"),
    [
        ((5.45, 2.5, 0.0), "in an obstacle of the map"),
        ((1.0, 1.0, 0.0), "in unknown space of the map"),
        ((20.0, 3.0, 0.0), r"outside of the map, which covers \(0.0, 0.0, 11.0, 9.0\)"),
        ((2.05, 3.0, 0.0), "in an obstacle, or only 0.05 m from one"),
    ],
)
def test_starts_that_are_not_free_say_what_is_there(tmp_path, start, where):
    load(tmp_path, "map_saver of Nav2")
    env = LidarEnv(Explore, world=str(tmp_path / "map.yaml"), physics="kinematic", start=start)
    with pytest.raises(ValueError, match=f"not collision-free .*: it lies {where}; spawns are"):
        env.reset(seed=0)
    grid = load_map(tmp_path / "map.yaml")
    assert class_at(grid, Pose2D(3.0, 3.0, 0.0)) == "in free space of the map"


def test_an_edited_image_is_another_world_and_an_image_is_no_world(tmp_path):
    before, path = load(tmp_path, "map_saver of Nav2"), tmp_path / "map.yaml"
    assert load_world(path) is before
    with pytest.raises(ValueError, match=r"map\.pgm is an image; name the YAML file of the map, such as .*map\.yaml"):
        load_world(str(tmp_path / "map.pgm"))
    pixels = greys(house())
    pixels[120:124, 50:54] = 0
    Image.fromarray(pixels).save(tmp_path / "map.pgm")
    assert len(load_world(path).segments) == len(before.segments) + 4
