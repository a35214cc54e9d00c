"""The same commands under both physics."""

import math

import numpy as np
import pytest

from envs.geometry import Pose2D, wrap_angle
from envs.robots import ROBOT_NAMES, load_robot
from envs.simulation import PHYSICS, Twist, make_simulator

POSITION = 0.025
"""Greatest distance between the two robots in 20 s of random commands, 2 to 6 m of path and 5 to 20 rad of turning
[m]."""
HEADING = 0.03
"""Greatest difference of their headings [rad]."""


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_random_commands_lead_to_the_same_pose(bullet, name, plain):
    robot = load_robot(name)
    simulators = [make_simulator(physics, robot, 0.1) for physics in PHYSICS]
    metres_per_tick = 2 * math.pi * robot.drive.wheel_radius / robot.odometry.ticks_per_rev
    for seed in range(3):
        rng = np.random.default_rng(100 + seed)
        for simulator in simulators:
            simulator.reset(plain, [Pose2D(0.0, 0.0, 0.3)], [np.random.default_rng(seed)])
        for step in range(200):
            if step % 5 == 0:
                command = Twist(*rng.uniform([-robot.max_v, -robot.max_w], [robot.max_v, robot.max_w]))
            readings = [simulator.step([command])[0] for simulator in simulators]
            a, b = (simulator.states[0].pose for simulator in simulators)
            assert math.dist(a[:2], b[:2]) < POSITION
            assert abs(wrap_angle(a.theta - b.theta)) < HEADING
            lag = np.abs(np.subtract(readings[0].ticks, readings[1].ticks)).max() * metres_per_tick
            assert lag < 0.01 + metres_per_tick
    simulators[0].close()
