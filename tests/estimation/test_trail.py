import numpy as np

from envs.estimation.trail import Trail
from envs.geometry import Pose2D


def test_trail_keeps_positions_apart_and_grows():
    trail = Trail()
    for k in range(6001):
        trail.append(Pose2D(0.01 * k, 0.0, 0.0))
    steps = np.diff(trail.positions[:, 0])
    assert 500 <= len(trail.positions) <= 601
    assert steps.min() >= 0.1 - 1e-9
