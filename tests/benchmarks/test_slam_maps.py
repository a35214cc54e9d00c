import numpy as np
from PIL import Image

from benchmarks import slam_maps
from envs.geometry import OccupancyGrid
from envs.rendering import style


def test_the_maps_of_a_drive_are_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(slam_maps, "NAMES", {"odometry": "Raw odometry", "hector": "Hector"})
    monkeypatch.delenv("LIDARNAUT_DATA", raising=False)
    slam_maps.main(tmp_path, "turtlebot3_world", "turtlebot3_burger", seed=0, minutes=0.2)
    assert "the Intel log is left out" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["slam_maps.png"]
    with Image.open(tmp_path / "slam_maps.png") as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape[1] == 1050
    for colour in (style.FREE, style.UNKNOWN):
        assert (np.abs(pixels - colour).max(axis=2) < 12).sum() > 2000
    assert (np.abs(pixels - style.TRUE).max(axis=2) < 60).sum() > 20  # the path


def test_walls_out_of_place_are_found():
    walls = OccupancyGrid(np.zeros((10, 10), dtype=np.int8), 1.0, (0.0, 0.0))
    far = np.ones((10, 10), dtype=bool)
    far[2, 3:6] = False  # near a true wall
    data = np.full((6, 30), -1, dtype=np.int8)
    data[4, 6], data[4, 14], data[4, 20], data[5, 14] = 100, 100, 100, 0
    grid = OccupancyGrid(data, 0.5, (0.0, 0.0))  # half as wide cells: (3.25, 2.25), (7.25, 2.25), (10.25, 2.25) m
    wrong = slam_maps.wrong_cells(grid, walls, far)
    assert np.argwhere(wrong).tolist() == [[4, 14], [4, 20]]
