import numpy as np
import pytest

from benchmarks.drives.recording import make_setup, record_drive
from benchmarks.drives.slams import measure_drive
from envs.robots import load_robot
from envs.slam import make_slam
from envs.worlds import load_world


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_minute_in_turtlebot3_world(physics):
    robot = load_robot("turtlebot3_burger")
    slam = make_slam("tinyslam", robot.lidar)
    setup = make_setup(load_world("turtlebot3_world"), robot, physics)
    drive = record_drive(setup, 11, 90.0)
    assert np.hypot(*np.diff(drive.truth[:, :2], axis=0).T).sum() > 10.0
    found, _ = measure_drive(setup, drive, slam, 11)
    assert found["translation_m"] < 0.05
    assert found["rotation_deg"] < 1.5
    assert found["map_iou"] > 0.9
