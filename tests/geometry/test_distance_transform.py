import numpy as np
import pytest
from scipy import ndimage

from envs.geometry.distance_transform import deepest_cell


@pytest.mark.parametrize("solid", [0.0, 0.005, 0.05, 0.4])
def test_the_deepest_cell_is_that_of_the_distance_transform(solid):
    rng = np.random.default_rng(0)
    for _ in range(60):
        area = np.pad(rng.random(rng.integers(1, 50, 2)) >= solid, 1)
        distances = ndimage.distance_transform_edt(area)
        assert deepest_cell(area) == np.unravel_index(np.argmax(distances), area.shape)


def test_long_and_comb_shaped_areas():
    comb = np.zeros((60, 201), dtype=bool)
    comb[1:8, 1:-1] = True
    comb[1:-1, 1::4] = True
    comb[3, 50] = False
    for area in (comb, comb.T.copy(), np.pad(np.ones((1, 70_000), dtype=bool), 1)):
        distances = ndimage.distance_transform_edt(area)
        assert deepest_cell(area) == np.unravel_index(np.argmax(distances), area.shape)
