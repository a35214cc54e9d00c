import math

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lines import resample
from lidarnaut.envs.navigation import COST_UNKNOWN
from lidarnaut.envs.simulation import Twist

PERIOD = 0.1
NOTHING = np.empty((0, 2))


def cost_at(costmap, x, y):
    """Cost at a position in the grid's frame [m]; unknown outside."""
    row, col = costmap.grid.cells((x, y))
    height, width = costmap.costs.shape
    return int(costmap.costs[row, col]) if 0 <= row < height and 0 <= col < width else COST_UNKNOWN


def path_through(*corners):
    return resample(np.array(corners), 0.05)


def moved(pose, twist, period=PERIOD):
    half = 0.5 * twist[1] * period
    length = twist[0] * period
    return pose.compose(Pose2D(length * math.cos(half), length * math.sin(half), 2.0 * half))


def drive(follower, robot, pose, num_steps, *, walls=NOTHING, people=NOTHING, jitter=0.0):
    """Simulate a unicycle with the robot's acceleration limits; return the poses, including the final one.

    `people`: rows of `tracks` at the start, map frame.
    """
    rng, people = np.random.default_rng(0), np.array(people, dtype=float)
    v = w = 0.0
    poses = [pose]
    for _ in range(num_steps):
        estimated = Pose2D(*(np.array(pose) + jitter * rng.normal(size=3)).tolist())
        obstacles = pose.inverse().transform(walls)
        noise = rng.normal(0.0, robot.lidar.noise_std, len(walls)) / np.hypot(*obstacles.T)
        if len(people):
            velocities = Pose2D(0.0, 0.0, -pose.theta).transform(people[:, 2:4])
            follower.tracks = np.column_stack([pose.inverse().transform(people[:, :2]), velocities, people[:, 4]])
            people[:, :2] += PERIOD * people[:, 2:4]
        command = follower.command(estimated, Twist(v, w), obstacles * (1.0 + noise)[:, None])
        assert abs(command.v) <= robot.max_v + 1e-9
        assert abs(command.w) <= robot.max_w + 1e-9
        v += float(np.clip(command.v - v, -robot.max_acc_v * PERIOD, robot.max_acc_v * PERIOD))
        w += float(np.clip(command.w - w, -robot.max_acc_w * PERIOD, robot.max_acc_w * PERIOD))
        pose = moved(pose, (v, w))
        poses.append(pose)
    return poses
