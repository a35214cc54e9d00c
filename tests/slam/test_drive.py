import numpy as np
import pytest

from benchmarks.recorded_drives import make_setup
from benchmarks.slam_drive import alignment, evaluate, record_drive
from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.slam import make_slam
from envs.worlds import load_world


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_minute_in_turtlebot3_world(physics):
    robot = load_robot("turtlebot3_burger")
    slam = make_slam("tinyslam", robot.lidar)
    setup = make_setup(load_world("turtlebot3_world"), robot, physics)
    result = evaluate(setup, record_drive(setup, 11, 90.0), slam, 11)
    assert result.path_length > 10.0
    assert result.slam_position < 0.05
    assert result.slam_heading < 1.5
    assert result.map_iou > 0.9
    assert np.isfinite(result.odometry_position)
    assert result.slam_position_aligned < result.slam_position


def test_alignment_finds_the_frame():
    points = np.random.default_rng(2).normal(size=(30, 2))
    frame = Pose2D(3.0, -1.0, 2.5)
    np.testing.assert_allclose(alignment(points, frame.transform(points)), frame)
