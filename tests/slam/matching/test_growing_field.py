import numpy as np

from envs.geometry import Pose2D
from envs.slam.matching.growing_field import GrowingField
from envs.slam.matching.submap_field import UNKNOWN_PERCENT, SensorModel, render_field

from .rooms import ROOM, take_scans


def test_field_equals_the_one_that_is_rendered_from_all_scans():
    poses = np.array([(1.0, 1.0, 0.0), (5.0, 3.2, 2.0), (2.5, 3.0, -1.0), (1.0, 3.5, 0.7)])
    scans = take_scans(ROOM, poses, num_beams=50, max_range=1.7)._replace(mount_x=0.1, mount_y=-0.03)
    growing = GrowingField(0.05, 0.1, -0.03, SensorModel())
    for k, pose in enumerate(poses):
        growing.integrate(scans.points[slice(*scans.spans[k])], Pose2D(*pose))
        some = scans._replace(spans=scans.spans[: k + 1], poses=scans.poses[: k + 1])
        field, geometry = render_field(some, 0.05, SensorModel())
        row, col = (round((a - b) / 0.05) for a, b in zip(geometry[1::-1], growing.geometry[1::-1]))
        height, width = field.shape
        np.testing.assert_array_equal(growing.field[row : row + height, col : col + width], field)
        known = (growing.field != UNKNOWN_PERCENT).sum()
        assert known == (field != UNKNOWN_PERCENT).sum()
