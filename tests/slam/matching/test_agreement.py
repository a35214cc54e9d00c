import math

import numpy as np

from envs.slam.matching.agreement import count_hits, fits_map


def test_hits_next_to_occupied_cells_agree_and_those_on_free_ones_do_not():
    occupancy = np.full((9, 9), -1, dtype=np.int8)
    occupancy[1:7, 1:6] = 0
    occupancy[1:7, 6] = 90
    # On the wall, next to it before and behind, free, unknown, and outside of the map; seen from (1, 4), heading up.
    points = np.array([(0, -5.5), (0, -4.5), (0, -6.5), (1, -2), (3.8, 0), (0, 40)], dtype=np.float32).T
    pose = (1.0, 4.0, 0.5 * math.pi)
    assert count_hits(occupancy, points, 6, *pose) == (3, 1)
    assert fits_map(occupancy, points, 6, pose, 0.5) is None
    many = np.repeat(points, 10, axis=1)
    assert fits_map(occupancy, many, 60, pose, 0.75) is True
    assert fits_map(occupancy, many, 60, pose, 0.76) is False
