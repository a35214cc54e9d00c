"""Two episodes side by side."""

from itertools import pairwise

import numpy as np

from benchmarks.arena.trace import Curve, Trace
from benchmarks.side_by_side import SideBySide, find_return
from envs.geometry import OccupancyGrid, Pose2D


def make_trace(seen_at):
    """A corridor of 100 cells of 0.1 m, each seen at a time; 1 s between two samples."""
    data = np.zeros((3, 102), dtype=np.int8)
    data[[0, 2]] = data[:, [0, -1]] = 100
    since = np.zeros(data.shape, dtype=np.float32)
    since[1, 1:-1] = seen_at
    time = np.arange(0.0, max(seen_at) + 1.0)
    fraction = np.array([np.mean(seen_at <= moment) for moment in time])
    trail = np.column_stack([1.0 + 0.1 * time, np.zeros(len(time))]).astype(np.float32)
    walls = np.array([[0.0, 0.0, 10.2, 0.0], [0.0, 0.3, 10.2, 0.3]], dtype=np.float32)
    grid = OccupancyGrid(data, 0.1, (0.0, 0.0))
    return Trace(Curve(time, 0.1 * time, fraction), trail, grid, since, Pose2D(0, 0, 0), walls, np.empty((0, 3)))


def test_the_longest_drive_through_what_is_known_and_its_pocket_are_found():
    # The first 20 cells are left behind at 3 s, when those beside them are seen; at 50 s the robot comes back to them.
    seen_at = np.concatenate([np.full(20, 50.0), 3.0 + np.arange(80.0) // 8])
    found = find_return(make_trace(seen_at))
    assert (found.begin, found.end, found.left_at) == (12.0, 49.0, 3.0)
    np.testing.assert_array_equal(np.argwhere(found.pocket), [(1, col) for col in range(1, 21)])
    assert np.isclose(found.area, 0.2)


def test_drives_after_the_mark_do_not_count():
    seen_at = np.concatenate([np.arange(96.0), np.full(4, 500.0)])
    assert find_return(make_trace(seen_at)).end <= 95.0


def test_both_are_drawn_at_the_same_moments():
    quick, slow = make_trace(np.arange(100.0) // 4), make_trace(np.arange(100.0))
    pictures = SideBySide({"quick": quick, "slow": slow})
    assert pictures.end == 99.0
    titles = [
        [axes.get_title().splitlines()[0] for axes in pictures.draw(moment).subfigs[0].axes] for moment in (20.0, None)
    ]
    assert titles == [["quick: 84 %", "slow: 21 %"], ["quick: 95 % after 23 s", "slow: 95 % after 94 s"]]
    frames = pictures.frames(3)
    assert len({frame.shape for frame in frames}) == 1
    assert all(np.any(a != b) for a, b in pairwise(frames))
