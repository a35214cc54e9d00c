import contextlib
import dataclasses

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import check_world, free_area, rasterize
from lidarnaut.envs.worlds.procedural.caves import contour
from lidarnaut.envs.worlds.raster import outline
from tests.rooms import square_room


def world_of(segments, circles=()):
    segments, circles = (np.array(rows, dtype=float).reshape(-1, size) for rows, size in ((segments, 4), (circles, 3)))
    return dataclasses.replace(square_room(1.0), segments=segments, circles=circles)


def cuts(segment, low, high):
    """Return True if a segment and a closed axis-aligned square share a point, by clipping (Liang and Barsky, 1984)."""
    start, step = np.array(segment[:2]), np.subtract(segment[2:], segment[:2])
    first, last = 0.0, 1.0
    for axis in range(2):
        if step[axis] == 0:
            if not low[axis] <= start[axis] <= high[axis]:
                return False
            continue
        near, far = sorted([(low[axis] - start[axis]) / step[axis], (high[axis] - start[axis]) / step[axis]])
        first, last = max(first, near), min(last, far)
    return first <= last


def test_every_touched_cell_is_marked_and_no_other():
    rng = np.random.default_rng(0)
    segments = np.vstack([rng.uniform(-1, 1, (25, 4)), np.round(rng.uniform(-1, 1, (25, 4)), 1)])
    circles = np.column_stack([rng.uniform(-0.7, 0.7, (5, 2)), rng.uniform(0.02, 0.3, 5)])
    for segment in segments:
        assert_marks_match(world_of([segment]), 0.1)
    for circle in circles:
        assert_marks_match(world_of([], [circle]), 0.1)


def assert_marks_match(world, resolution):
    grid = rasterize(world, resolution)
    marked = np.zeros(grid.data.shape, dtype=bool)
    sure = np.zeros(grid.data.shape, dtype=bool)
    for cell in np.ndindex(grid.data.shape):
        centre = grid.centers(np.array(cell))
        # Rounding may decide between a slightly smaller and a slightly larger square.
        for half, out in ((resolution / 2 + 1e-3, marked), (resolution / 2 - 1e-3, sure)):
            low, high = centre - half, centre + half
            out[cell] = any(cuts(segment, low, high) for segment in world.segments) or any(
                np.hypot(*(np.clip((x, y), low, high) - (x, y))) <= radius for x, y, radius in world.circles
            )
    assert (grid.data[sure] == 100).all()
    assert (grid.data[~marked] == 0).all()


def test_free_area_shrinks_by_the_robots_radius():
    world = square_room(1.0)
    assert free_area(world) == pytest.approx(4.0, abs=0.25)
    assert free_area(world, radius=0.3) == pytest.approx(1.4**2, abs=0.2)
    assert free_area(world, radius=1.1) == 0.0


@pytest.mark.parametrize(("top", "leaks"), [(-0.8, True), (-0.98, False), (-1.0, False)])
def test_worlds_leak_through_gaps_wider_than_a_cell(top, leaks):
    world = world_of([*square_room(1.0).segments[:3], (-1, 1, -1, top)])
    with pytest.raises(ValueError, match="leaks") if leaks else contextlib.nullcontext():
        assert check_world(world) is world


def test_outline_is_every_border_once():
    rng = np.random.default_rng(1)
    solid = rng.random((12, 17)) < 0.4
    xs, ys = np.cumsum(rng.uniform(0.1, 1.0, 18)), np.cumsum(rng.uniform(0.1, 1.0, 13))
    expected = set()
    for row, col in np.ndindex(12, 17):
        if solid[row, col]:
            continue
        for d_row, d_col in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            r, c = row + d_row, col + d_col
            if not (0 <= r < 12 and 0 <= c < 17) or solid[r, c]:
                border = ("x", row, col + max(d_col, 0)) if d_col else ("y", row + max(d_row, 0), col)
                expected.add(border)
    found = []
    for x0, y0, x1, y1 in outline(solid, xs, ys):
        i0, i1, j0, j1 = (np.searchsorted(a, v) for a, v in ((xs, x0), (xs, x1), (ys, y0), (ys, y1)))
        assert (i0 == i1) != (j0 == j1)
        found += [("x", row, i0) for row in range(j0, j1)] + [("y", j0, col) for col in range(i0, i1)]
    assert len(found) == len(set(found))
    assert set(found) == expected


def test_contour_of_two_cones_is_two_closed_circles():
    y, x = np.mgrid[:40, :70]
    field = np.minimum(np.hypot(x - 15, y - 20), np.hypot(x - 50, y - 18))
    segments = contour(field, 9.3, tolerance=0.25)
    assert len(segments) < 60
    assert sorted(map(tuple, segments[:, :2])) == sorted(map(tuple, segments[:, 2:]))
    middles = (segments[:, :2] + segments[:, 2:]) / 2
    for points in (segments[:, :2], middles):
        distance = np.minimum(np.hypot(*(points - (15, 20)).T), np.hypot(*(points - (50, 18)).T))
        assert np.abs(distance - 9.3).max() < 0.3
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum()
    assert length == pytest.approx(2 * 2 * np.pi * 9.3, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"spawns": [Pose2D(0.5, 0.0, 0.0)]}, r"\(0\.5, 0\.0, 0\.0\) lies on"),
        ({"spawns": [Pose2D(0.0, 0.0, 0.0), Pose2D(0.8, 0.0, 0.0)]}, "cannot be reached"),
        ({"spawns": [Pose2D(3.0, 0.0, 0.0)]}, "outside its bounds"),
        ({"spawns": []}, "no spawn"),
        ({"bounds": (-1e6, -1.0, 1e6, 1.0)}, r"cells of 0\.05 m; at most 100,000,000"),
    ],
)
def test_what_is_wrong_with_a_world_is_named(changes, complaint):
    with pytest.raises(ValueError, match=complaint):
        check_world(dataclasses.replace(square_room(1.0, [(0.5, -1, 0.5, 1)]), **changes))


def test_rasters_that_are_too_large_are_refused_at_once():
    with pytest.raises(ValueError, match=r"'test' spans 2 x 2 m, which is 4e\+10 cells of 1e-05 m"):
        rasterize(square_room(1.0), 1e-5)
    # A huge disc is drawn only within the raster, in little time.
    assert (rasterize(world_of([], [(0.0, 0.0, 1e7)]), 0.05).data == 100).all()
