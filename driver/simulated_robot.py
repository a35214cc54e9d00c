"""Simulated robot that sends messages like a real one."""

from typing import Any

import numpy as np

from lidarnaut.envs.arguments import choose_robot
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist, make_simulator
from lidarnaut.envs.simulation.crowd import crowd_of
from lidarnaut.envs.worlds import explorable_area, world_sampler


class SimulatedRobot:
    """Robot in a simulated world, with odometry at a high rate, for programs that drive by messages."""

    def __init__(
        self,
        world: Any = "turtlebot3_house",
        robot: str | RobotParams | None = None,
        *,
        physics: str = "kinematic",
        people: Any = None,
        start: str = "random",
        rate: float = 50.0,
        seed: int = 0,
    ) -> None:
        """Place a robot at a random start, or at the world's first spawn (`start="spawn"`).

        `world`, `robot`, `physics`, `people`: as in `LidarEnv`. `rate`: steps and odometry messages per second [Hz].
        ValueError for a value that is not allowed.
        """
        if start not in ("random", "spawn"):
            raise ValueError(f"start must be 'random' or 'spawn', got {start!r}")
        self.robot = choose_robot(robot, world)
        self.period = 1.0 / rate
        rng = np.random.default_rng(seed)
        self.world = world_sampler(world, radius=self.robot.radius)(rng)
        self.area = explorable_area(self.world, self.robot, 0.05)
        self.start = self.world.spawns[0] if start == "spawn" else self.area.draw_pose(rng)
        """True pose of the odometry frame, world frame."""
        self.simulator = make_simulator(physics, self.robot, self.period, crowd=crowd_of(people))
        self.simulator.deskews = False
        crowd_rng = rng if self.simulator.crowd.params else None
        (self.reading,) = self.simulator.reset(self.world, [self.start], [rng.spawn(1)[0]], crowd_rng)

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return self.reading.time

    @property
    def odometry(self) -> Pose2D:
        """Base pose in the odometry frame, which begins at the start."""
        return self.reading.odometry

    @property
    def twist(self) -> Twist:
        """Velocity by odometry."""
        return Twist(self.reading.motion.x / self.period, self.reading.motion.theta / self.period)

    @property
    def pose(self) -> Pose2D:
        """True pose, world frame."""
        return self.simulator.states[0].pose

    def step(self, command: Twist) -> Reading:
        """Simulate one period with a velocity command; return the readings."""
        (self.reading,) = self.simulator.step([command])
        return self.reading
