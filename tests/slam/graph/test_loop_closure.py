import math

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.slam.graph.loop_closure import (
    Confirmation,
    HitShares,
    Loop,
    LoopClosureParams,
    hit_shares,
    is_accepted,
    search_window,
)
from envs.slam.matching.submap_field import FieldGeometry

PARAMS = LoopClosureParams()


def test_windows_grow_with_the_path_up_to_a_limit():
    assert search_window(0.0, PARAMS) == (0.5, 0.1)
    assert search_window(10.0, PARAMS) == pytest.approx((1.1, 0.25))
    assert search_window(1e3, PARAMS) == (4.0, 0.6)


def test_hits_are_counted_by_what_they_fall_on():
    field = np.full((6, 8), 50, dtype=np.uint8)
    field[:, :4] = 10
    field[2, 3] = 90
    geometry = FieldGeometry(1.0, 2.0, 0.5)
    cells = [(2, 3), (1, 2), (3, 4), (0, 0), (5, 1), (5, 6), (-3, 2), (2, 90)]  # row, column
    points = np.array([[1.0 + 0.5 * (q + 0.5), 2.0 + 0.5 * (r + 0.5)] for r, q in cells])
    pose = Pose2D(0.3, -0.4, 0.8)
    local = np.array([pose.inverse().compose(Pose2D(*point, 0.0))[:2] for point in points], dtype=np.float32)
    shares = hit_shares(field, geometry, local, pose)
    # On the wall, twice next to it; two free, one unknown, two outside.
    assert shares == pytest.approx((0.9 / 8, 3 / 8, 2 / 8))
    assert hit_shares(field, geometry, local[:0], pose) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("shares", "accepted"),
    [
        (HitShares(0.7, 0.9, 0.05), True),
        (HitShares(0.39, 0.9, 0.05), False),  # beside the walls
        (HitShares(0.6, 0.45, 0.0), False),  # most is unknown
        (HitShares(0.6, 0.8, 0.16), False),  # too many in free space
        (HitShares(0.51, 0.52, 0.14), True),
        (HitShares(0.51, 0.51, 0.15), True),
    ],
)
def test_hits_must_agree_with_what_is_occupied_and_free(shares, accepted):
    assert is_accepted(shares, PARAMS) is accepted
    assert not is_accepted(shares, LoopClosureParams(min_agreement=0.99)) or shares.free == 0.0


def loop(node, before, shift):
    """Return a loop closure that moves a node by a correction of the map as a whole."""
    before = Pose2D(*before)
    return Loop(node, 0, Pose2D(0, 0, 0), np.eye(3), before, Pose2D(*shift).compose(before))


def test_small_corrections_are_taken_at_once():
    confirmation = Confirmation(PARAMS)
    small = loop(100, (3.0, 1.0, 0.0), (0.2, 0.0, 0.0))
    assert confirmation.add(small) == [small]


def test_large_corrections_wait_for_a_second_one_that_agrees():
    shift = (0.8, -0.3, 0.1)
    first = loop(100, (3.0, 1.0, 0.5), shift)
    same_node = loop(100, (3.0, 1.0, 0.5), shift)
    other = loop(104, (3.5, 1.5, 1.0), (0.1, 0.9, 0.1))
    second = loop(110, (4.0, 2.5, 2.0), shift)
    confirmation = Confirmation(PARAMS)
    assert confirmation.add(first) == []
    assert confirmation.add(same_node) == []
    assert confirmation.add(other) == []
    assert confirmation.add(second) == [first, second]
    # Turned otherwise it does not agree, and neither does it after too many nodes.
    confirmation = Confirmation(PARAMS)
    assert confirmation.add(first) == []
    turned = second._replace(after=second.after._replace(theta=second.after.theta + 0.06))
    assert confirmation.add(turned) == []
    assert confirmation.add(loop(126, (4.0, 2.5, 2.0), shift)) == []


@pytest.mark.parametrize("change", [{"half_width": 0.0}, {"max_half_angle": math.inf}, {"min_score": 1.2}])
def test_params_that_make_no_sense_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        LoopClosureParams(**change)
