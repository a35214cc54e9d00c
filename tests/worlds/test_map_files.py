import os
import struct
import warnings
import zlib

import numpy as np
import pytest
import yaml
from PIL import Image
from scipy import ndimage

from lidarnaut.envs.geometry import OCCUPIED_FROM, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.distance_transform import deepest_cell
from lidarnaut.envs.worlds import free_area, load_map, load_world, rasterize, save_map, world_from_map, world_sampler


def grid_of(data):
    return OccupancyGrid(np.array(data, dtype=np.int8), 0.1, (-1.0, 2.0))


@pytest.mark.parametrize("name", ["map", "map.yaml", "map.pgm", "map.png"])
def test_maps_survive_saving_and_loading(tmp_path, name):
    grid = grid_of(np.random.default_rng(0).choice([-1, 0, 100], (5, 8)))
    path = save_map(grid, tmp_path / name)
    assert path == tmp_path / "map.yaml"
    image = tmp_path / ("map.png" if name == "map.png" else "map.pgm")
    assert sorted(os.listdir(tmp_path)) == sorted([image.name, "map.yaml"])
    back = load_map(path)
    np.testing.assert_array_equal(back.data, grid.data)
    assert (back.resolution, back.origin) == (grid.resolution, grid.origin)


def test_saved_files_are_those_of_map_saver_with_the_classes_of_planners(tmp_path):
    # Top row of the image is the highest y.
    path = save_map(grid_of([[0, 19, 49], [50, 65, -1]]), tmp_path / "map")
    assert (tmp_path / "map.pgm").read_bytes().startswith(b"P5")
    assert np.asarray(Image.open(tmp_path / "map.pgm")).tolist() == [[0, 0, 205], [254, 254, 254]]
    place = {"image": "map.pgm", "resolution": 0.1, "origin": [-1.0, 2.0, 0.0]}
    classes = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196, "mode": "trinary"}
    assert yaml.safe_load(path.read_text()) == place | classes
    grid = grid_of(np.arange(-1, 101).reshape(6, 17))
    data = load_map(save_map(grid, tmp_path / "map")).data
    np.testing.assert_array_equal(data, np.where(grid.data < 0, -1, np.where(grid.data >= OCCUPIED_FROM, 100, 0)))
    np.testing.assert_array_equal(load_map(save_map(grid, tmp_path / "scale", "scale")).data, grid.data)
    assert yaml.safe_load((tmp_path / "scale.yaml").read_text())["image"] == "scale.png"
    with pytest.raises(ValueError, match=r"scale as \.png, got 'scale' for .*map\.pgm"):
        save_map(grid, tmp_path / "map.pgm", "scale")


def write_map(tmp_path, pixels, **changes):
    pixels = np.array(pixels, dtype=None if isinstance(pixels, np.ndarray) else np.uint8)
    Image.fromarray(pixels).save(tmp_path / "m.png")
    content = {"image": "m.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    content |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | changes
    (tmp_path / "m.yaml").write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return tmp_path / "m.yaml"


GREYS = [[0, 40, 128, 205, 254]]
COLOURS = [[[255, 255, 255, 255], [255, 255, 255, 0], [30, 0, 60, 255]]]
"""Averaged; the second pixel is transparent."""


@pytest.mark.parametrize(
    ("pixels", "changes", "expected"),
    [
        (GREYS, {}, [100, 100, -1, -1, 0]),
        (257 * np.array(GREYS, dtype=np.uint16), {}, [100, 100, -1, -1, 0]),
        (GREYS, {"mode": "trinary", "negate": 1}, [0, 0, -1, 100, 100]),
        # (1 - 128 / 255 - 0.196) / (0.65 - 0.196) = 0.665; 205 is slightly above the threshold for free.
        (GREYS, {"mode": "scale"}, [100, 100, 67, 0, 0]),
        (GREYS, {"mode": "raw"}, [0, 40, -1, -1, -1]),
        (GREYS, {"free_thresh": 0.25}, [100, 100, -1, 0, 0]),
        ([[0, 205, 254, 255]], {"free_thresh": 0.25}, [100, -1, 0, 0]),
        ([[0, 205, 254, 255]], {"free_thresh": 0.25, "negate": 1}, [0, 100, 100, 100]),
        ([[0, 205, 254, 255]], {"free_thresh": 0.25, "mode": "scale"}, [100, 0, 0, 0]),
        # Mean of colours and opacity, as in map_server: (3 * 255 + 0) / 4 = 191 is unknown.
        (COLOURS, {}, [0, -1, 100]),
        (COLOURS, {"negate": 1}, [100, 100, -1]),
        ([[[205, 205, 205, 255], [254, 254, 254, 255], [0, 0, 0, 255]]], {}, [-1, 0, 100]),
        (COLOURS, {"mode": "scale"}, [0, -1, 100]),
    ],
)
def test_modes_thresholds_negate_and_colours(tmp_path, pixels, changes, expected):
    assert load_map(write_map(tmp_path, pixels, **changes)).data.tolist() == [expected]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"origin": [0, 0, 0.5]}, "yaw of 0.5"),
        ({"origin": [0, 0]}, "origin"),
        ({"resolution": 0}, "resolution"),
        ({"occupied_thresh": None}, "occupied_thresh"),
        ({"mode": "binary"}, "mode.*trinary"),
        ({"free_thresh": 0.7}, "free_thresh"),
        ({"resolution": 1e5}, r"world 'm' spans 200000 x 100000 m, .*cells of 0\.05 m; at most 100,000,000"),
        ({"resolution": 1e300}, r"resolution: .*1e\+300"),
        ({"resolution": 1e-320}, "world 'm': spawn"),
        ({"origin": [1e308, 0, 0]}, r"origin\.0: .*1e\+308"),
    ],
)
def test_damaged_maps_are_named(tmp_path, changes, message):
    with pytest.raises(ValueError, match=rf"m\.yaml.*{message}"):
        load_world(write_map(tmp_path, [[254, 254]], **changes))


def png(width, height):
    """PNG of this size in a few bytes: header, and no pixels."""
    chunks = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0), b"IDAT" + zlib.compress(b""), b"IEND"
    parts = (struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) for chunk in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (png(100_000, 100_000), "pixels"),
        (png(12_000, 9_000), "12000 x 9000 pixels; at most 100,000,000"),
        (png(300, 200), "cannot be read"),
        (b"P5 99999999999 99999999999 255\n", "cannot be read"),
        (b"P5 -4 4 255\n" + b"x" * 16, "cannot be read"),
        (b"II*\0\x08\0\0\0\x60\xea" + b"\xff" * 100, "cannot identify"),  # Pillow warns, too
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot identify"),
    ],
)
def test_images_that_lie_about_their_size_are_named(tmp_path, content, message):
    path = write_map(tmp_path, [[254]])
    (tmp_path / "m.png").write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=rf"map image .*m\.png.*{message}"):
            load_map(path)


def test_missing_images_wrong_suffixes_and_failed_writes_are_named(tmp_path):
    path = write_map(tmp_path, [[0]], image="gone.pgm")
    with pytest.raises(FileNotFoundError, match=r"gone\.pgm"):
        load_map(path)
    with pytest.raises(ValueError, match=r"\.bmp"):
        save_map(grid_of([[0]]), tmp_path / "map.bmp")
    with pytest.raises(OSError, match=r"cannot save .*map\.pgm: Not a directory"):
        save_map(grid_of([[0]]), path / "map")


def test_a_world_saved_as_a_map_comes_back_as_a_world(tmp_path):
    house = load_world("turtlebot3_house")
    path = save_map(rasterize(house, 0.05), tmp_path / "house.png")
    again = world_sampler(str(path))(np.random.default_rng(0))
    assert (again.name, again.source) == ("house", str(path))
    assert again is load_world(path)
    assert free_area(again) == pytest.approx(free_area(house), rel=0.06)
    assert world_from_map(load_map(path), "copy", house.spawns[0]).spawns == house.spawns[:1]


def test_unknown_is_solid_and_the_spawn_lies_deepest():
    data = np.zeros((20, 30), dtype=np.int8)
    data[:, 20:] = -1
    data[5, 5] = 100
    world = world_from_map(OccupancyGrid(data, 0.1, (0.0, 0.0)), "half")
    # Around the free part, and around the one occupied cell.
    assert len(world.segments) == 4 + 4
    assert world.bounds == pytest.approx((0.0, 0.0, 2.0, 2.0))
    x, y, _ = world.spawns[0]
    assert 1.0 < x < 1.4
    assert 0.8 < y < 1.4
    with pytest.raises(ValueError, match=r"spawn .* of map .half. lies in unknown space of the map"):
        world_from_map(OccupancyGrid(data, 0.1, (0.0, 0.0)), "half", spawn=Pose2D(2.5, 1.0, 0.0))
    with pytest.raises(ValueError, match="no free cell"):
        world_from_map(OccupancyGrid(np.full((3, 3), -1, dtype=np.int8), 0.1, (0.0, 0.0)), "void")


@pytest.mark.parametrize("solid", [0.0, 0.005, 0.05, 0.4])
def test_robots_start_where_the_distance_transform_is_greatest(solid):
    rng = np.random.default_rng(0)
    for _ in range(60):
        area = np.pad(rng.random(rng.integers(1, 50, 2)) >= solid, 1)
        distances = ndimage.distance_transform_edt(area)
        assert deepest_cell(area) == np.unravel_index(np.argmax(distances), area.shape)
