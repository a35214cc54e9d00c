import math

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.observation import CROP_SIZE, SAMPLES, Trail, crop_map


def crop_slowly(data, origin, resolution, pose, pixel, trail):
    """What `crop_map` computes, look-up by look-up."""
    crop = np.zeros((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    half = CROP_SIZE * pixel / 2
    for i, j in np.ndindex(CROP_SIZE, CROP_SIZE):
        values = []
        for a, b in np.ndindex(SAMPLES, SAMPLES):
            ahead = (i + (a + 0.5) / SAMPLES) * pixel - half
            left = (j + (b + 0.5) / SAMPLES) * pixel - half
            x, y = pose.transform([[ahead, left]])[0]
            row, col = math.floor((y - origin[1]) / resolution), math.floor((x - origin[0]) / resolution)
            inside = 0 <= row < data.shape[0] and 0 <= col < data.shape[1]
            values.append(int(data[row, col]) if inside else -1)
        crop[0, i, j] = 255 if max(values) >= 50 else 0
        crop[1, i, j] = 255 * sum(0 <= value < 50 for value in values) // SAMPLES**2
    for ahead, left in pose.inverse().transform(trail):
        i, j = math.floor((ahead + half) / pixel), math.floor((left + half) / pixel)
        if 0 <= i < CROP_SIZE and 0 <= j < CROP_SIZE:
            crop[2, i, j] = 255
    return crop


@pytest.mark.parametrize("pixel", [0.2, 0.8])
def test_crop_equals_the_slow_one(pixel):
    rng = np.random.default_rng(3)
    data = rng.choice(np.array([-1, 0, 30, 50, 100], dtype=np.int8), size=(150, 130), p=[0.5, 0.3, 0.1, 0.05, 0.05])
    trail = rng.uniform(-4, 4, size=(30, 2))
    pose, origin = Pose2D(0.83, -0.41, 2.1), (-3.5, -4.2)
    crop = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    crop_map(data, *origin, 0.05, *pose, pixel, trail, crop)
    slow = crop_slowly(data, origin, 0.05, pose, pixel, trail)
    # Look-ups that fall on a border between cells may go either way in single precision.
    assert np.mean(crop[:2] != slow[:2]) < 0.005
    np.testing.assert_array_equal(crop[2], slow[2])


def test_crop_points_forward_and_left():
    data = np.full((200, 200), -1, dtype=np.int8)
    crop = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    # The robot stands at the origin and looks along +y; a wall lies 2 m ahead, free space 2 m to its left (-x).
    data[140:144, 96:104] = 100
    data[96:104, 58:62] = 0
    crop_map(data, -5.0, -5.0, 0.05, 0.0, 0.0, math.pi / 2, 0.2, np.empty((0, 2)), crop)
    ahead = np.argwhere(crop[0])
    assert (ahead[:, 0] >= 30).all()
    assert ahead[:, 1].mean() == pytest.approx(19.5, abs=0.6)
    left = np.argwhere(crop[1])
    assert (left[:, 1] >= 28).all()
    assert left[:, 0].mean() == pytest.approx(19.5, abs=0.6)


def test_trail_keeps_positions_apart_and_grows():
    trail = Trail()
    for k in range(6001):
        trail.append(Pose2D(0.01 * k, 0.0, 0.0))
    steps = np.diff(trail.positions[:, 0])
    assert 500 <= len(trail.positions) <= 601
    assert steps.min() >= 0.1 - 1e-9
