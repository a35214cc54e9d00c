import numpy as np
import pytest

from benchmarks.slam_drive import drive
from envs.robots import load_robot
from envs.slam import make_slam
from envs.worlds import load_world


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_minute_in_turtlebot3_world(physics):
    robot = load_robot("turtlebot3_burger")
    slam = make_slam("tinyslam", robot.lidar)
    result = drive(load_world("turtlebot3_world"), robot, physics, slam, seed=11, duration=90.0)
    assert result.path_length > 10.0
    assert result.slam_position < 0.05
    assert result.slam_heading < 1.5
    assert result.map_iou > 0.9
    assert np.isfinite(result.odometry_position)
