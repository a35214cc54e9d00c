import math

import numpy as np
import pytest

from envs.slam.matching.submap_field import UNKNOWN_PERCENT, Scans, SensorModel, render_field

from .rooms import ROOM, take_scans


def reference(scans, geometry, shape, model):
    """Return log-odds in hundredths by loops over cells."""
    values = np.zeros(shape, dtype=int)
    for (first, last), (x, y, theta) in zip(scans.spans, scans.poses):
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])

        def cell(point, turn=turn, at=(x, y)):
            place = turn @ np.asarray(point, dtype=float) + at
            return tuple(np.floor((place - (geometry.x, geometry.y)) / geometry.resolution).astype(int)[::-1])

        row, col = cell((scans.mount_x, scans.mount_y))
        hits = [cell(point) for point in scans.points[first:last]]
        passed = set()
        for r, q in hits:
            steps = max(abs(r - row), abs(q - col))
            for k in range(steps):
                # Right between two cells, the one nearer to the start.
                dr, dq = ((2 * k * abs(d) + steps - 1) // (2 * steps) for d in (r - row, q - col))
                passed.add((row + int(math.copysign(dr, r - row)), col + int(math.copysign(dq, q - col))))
        for at in set(hits):
            values[at] = min(values[at] + model.hit, model.limit)
        for at in passed - set(hits):
            values[at] = max(values[at] + model.passed, -model.limit)
    return values


def test_field_equals_the_slow_reference():
    rng = np.random.default_rng(0)
    poses = np.stack([rng.uniform(1, 5, 12), rng.uniform(1, 3, 12), rng.uniform(-3, 3, 12)], axis=1)
    scans = take_scans(ROOM, poses, num_beams=60)._replace(mount_x=0.1, mount_y=-0.05)
    model = SensorModel(limit=500)
    field, geometry = render_field(scans, 0.05, model)
    values = reference(scans, geometry, field.shape, model)
    assert values.max() == 500
    assert values.min() < -300
    expected = np.round(100.0 / (1.0 + np.exp(-values / 100.0)))
    np.testing.assert_array_equal(field, expected)


def test_one_beam_by_hand():
    points = np.array([[0.5, 0.0], [9.0, 9.0], [0.3, 0.3]], dtype=np.float32)  # the second is of another scan
    spans = np.array([[0, 1], [2, 3]])
    poses = np.array([[0.05, 0.05, 0.0], [0.05, 0.05, 0.0]])
    field, geometry = render_field(Scans(points, spans, poses, 0.0, 0.0), 0.1, SensorModel())
    col, row = round(-geometry.x / 0.1), round(-geometry.y / 0.1)
    assert field.shape == (row + 3 + 2, col + 5 + 2)
    seen = field[row : row + 4, col : col + 6]
    free, twice = 40, 31  # log-odds of -0.41 and -0.82
    assert seen[0].tolist() == [twice, free, free, free, free, 90]
    assert [seen[k, k] for k in range(4)] == [twice, free, free, 90]
    assert (field == UNKNOWN_PERCENT).sum() == field.size - 9


def test_scans_that_do_not_fit_are_refused():
    empty = Scans(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.int64), np.zeros((0, 3)), 0.0, 0.0)
    assert render_field(empty, 0.05, SensorModel())[0].tolist() == [[UNKNOWN_PERCENT]]
    many = empty._replace(spans=np.zeros((5000, 2), np.int64), poses=np.zeros((5000, 3)))
    with pytest.raises(ValueError, match="4095"):
        render_field(many, 0.05, SensorModel())
