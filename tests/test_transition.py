"""The kernels of a control period against the classes that do the same one after the other, in Python."""

import numpy as np
import pytest

from envs.core import LidarEnv
from envs.estimation.motion import make_motion_source
from envs.geometry import Pose2D
from envs.tasks.explore import Explore
from tests.test_core import QUICK


@pytest.mark.parametrize("robot", ["turtlebot3_burger", "raspimouse"])
@pytest.mark.parametrize("slam", ["odometry", "truth"])
def test_a_row_holds_what_readings_and_states_come_to(slam, robot):
    env = LidarEnv(Explore, slam=slam, **{**QUICK, "robot": robot})
    env.reset(seed=2)
    odometry, one, truth = make_motion_source(env.robot, env.control_period), env.robots[0], env.truths[0]
    odometry.reset(env.reading)
    pose, true_pose, length, contacts, was_touched = Pose2D(0.0, 0.0, 0.0), truth.state.pose, 0.0, 0, False
    positions = [true_pose[:2]]
    rng = np.random.default_rng(1)
    for _ in range(40):
        env.step(rng.uniform((0.3, -0.5), (1.0, 0.5)).astype(np.float32))
        by_wheels, before, true_pose = odometry.update(env.reading), true_pose, truth.state.pose
        motion = before.between(true_pose) if slam == "truth" else by_wheels
        pose = pose.compose(motion)
        length += float(np.sqrt((true_pose.x - before.x) ** 2 + (true_pose.y - before.y) ** 2))
        contacts += env.reading.bumper and not was_touched
        was_touched = env.reading.bumper
        if np.hypot(*np.subtract(true_pose[:2], positions[-1])) >= 0.1:
            positions.append(true_pose[:2])
        assert one.motion == motion
        assert one.belief.pose == one.predicted_pose == pose
        assert one.twist == (by_wheels.x / env.control_period, by_wheels.theta / env.control_period)
        assert (one.collisions, one.bumper) == (contacts, was_touched)
        assert truth.path_length == pytest.approx(length, abs=1e-12)
        np.testing.assert_array_equal(truth.trail.positions, positions)
    assert len(positions) > 5
