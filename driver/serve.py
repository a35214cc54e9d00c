"""A simulated robot as ROS topics, without ROS or through rosbridge: `lidarnaut-serve --port 9090 --people 6`."""

import contextlib
import functools
import logging
import math
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import check_positive
from lidarnaut.envs.logs import messages
from lidarnaut.envs.simulation import Twist

from .gate import check_numbers
from .program import first_signal, run_program
from .rosbridge import Rosbridge
from .server import RosbridgeServer
from .simulated_robot import SimulatedRobot

LOGGER = logging.getLogger(__name__)
SCAN_PERIOD, TIMEOUT = 0.1, 0.5
"""Time between scans, unless a lidar takes longer, and time for which a command holds [simulated s]."""


@dataclass(frozen=True)
class Options:
    """Options of the simulated robot."""

    port: int | None = None
    """Port at which clients of rosbridge find the robot, such as 9090; no other server is needed."""
    bind: str = "127.0.0.1"
    """Address of the port; 0.0.0.0 lets other computers connect."""
    url: str | None = None
    """Address of another rosbridge server, instead of a port; default: ws://localhost:9090."""
    world: str = "turtlebot3_house"
    """Library world, procedural family, or path of a world or map YAML."""
    robot: str | None = None
    """Library robot or path of a robot YAML; default: that of the world."""
    people: int = 0
    """Number of pedestrians."""
    physics: str = "kinematic"
    """`kinematic` or `bullet`."""
    start: str = "spawn"
    """Start: `spawn` or `random`."""
    seed: int = 0
    """Seed of world, start, noise and people."""
    rate: float = 50.0
    """Odometry messages per simulated second [Hz]."""
    speed: float = 1.0
    """Simulated seconds per second."""
    namespace: str = ""
    """Prefix of all topics except `/clock`, such as `robot1`."""
    stamped: bool = False
    """Whether commands are TwistStamped messages instead of Twist."""


class Server:
    """Simulated robot that drives by `/cmd_vel`.

    Publishes `/clock`, `/scan`, `/odom`, `/imu`, `/tf` and `/tf_static`.
    """

    def __init__(self, options: Options, bridge: Rosbridge, robot: SimulatedRobot | None = None) -> None:
        """Advertise the topics of a robot, by default a new one; ValueError for an unknown world or robot."""
        self._options = options
        self.robot = robot or make_robot(options)
        self._bridge, self._command, self._commanded, self._has_warned = bridge, Twist(0.0, 0.0), -math.inf, False
        self._next_scan = self.robot.robot.lidar.scan_time
        for topic, kind in {
            "/clock": "rosgraph_msgs/msg/Clock",
            "/odom": "nav_msgs/msg/Odometry",
            "/imu": "sensor_msgs/msg/Imu",
            "/scan": "sensor_msgs/msg/LaserScan",
            "/tf": "tf2_msgs/msg/TFMessage",
        }.items():
            bridge.advertise(topic, kind)
        bridge.advertise("/tf_static", "tf2_msgs/msg/TFMessage", latch=True)
        bridge.publish("/tf_static", messages.static_transforms(self.robot.robot.lidar.mount))
        kind = "geometry_msgs/msg/TwistStamped" if options.stamped else "geometry_msgs/msg/Twist"
        bridge.subscribe("/cmd_vel", kind, self._receive)

    def _receive(self, message: Any) -> None:
        try:
            twist = message.twist if self._options.stamped else message
            command = Twist(*check_numbers("velocity command", (twist.linear.x, twist.angular.z)))
        except (AttributeError, ValueError) as error:
            if not self._has_warned:
                LOGGER.warning("/cmd_vel: wrong commands are dropped: %s", error)
            self._has_warned = True
            return
        self._command, self._commanded = command, self.robot.time

    def step(self) -> None:
        """Publish the state of the robot, and simulate one period."""
        robot, publish = self.robot, self._bridge.publish
        now, lidar = messages.RESET_STAMP + robot.time, robot.robot.lidar
        publish("/clock", messages.clock(now))
        publish("/odom", messages.odometry(now, robot.odometry, robot.twist))
        publish("/imu", messages.imu(now, robot.reading.yaw_rate))
        publish("/tf", messages.transforms(now, (messages.ODOM, messages.BASE, robot.odometry)))
        if robot.time >= self._next_scan - 1e-9:
            period = max(SCAN_PERIOD, lidar.scan_time)
            self._next_scan += period
            clear, invalid = (0.0, -1.0) if lidar.no_return == "zero" else (lidar.range_max + 1.0, 0.0)
            # rosbridge refuses infinite numbers and NaN; numbers outside of the limits mean the same.
            ranges = np.nan_to_num(robot.reading.ranges, nan=invalid, posinf=clear)
            began = now - lidar.time_increment * (lidar.num_beams - 1)
            publish("/scan", messages.laser_scan(began, ranges, lidar, period, lidar.time_increment))
        is_fresh = robot.time - self._commanded <= TIMEOUT
        robot.step(self._command if is_fresh else Twist(0.0, 0.0))

    def run(self, is_over: threading.Event) -> None:
        """Simulate at the chosen multiple of real time."""
        began, speed = time.monotonic() - self.robot.time / self._options.speed, self._options.speed
        while not is_over.is_set():
            self._bridge.spin()
            self.step()
            ahead = self.robot.time / speed - (time.monotonic() - began)
            began -= min(ahead, 0.0)  # if too slow, do not catch up
            time.sleep(max(ahead, 0.0))


def make_robot(options: Options) -> SimulatedRobot:
    """Place a robot in its world; ValueError for an unknown world or robot."""
    o = options
    return SimulatedRobot(
        o.world, o.robot, physics=o.physics, people=o.people or None, start=o.start, rate=o.rate, seed=o.seed
    )


def main(options: Options) -> None:
    """Simulate a robot in real time, or at a multiple, until Ctrl-C.

    Raises:
        ValueError: an option has a value that is not allowed.
        OSError: the port cannot be opened.
    """
    check_positive(speed=options.speed, rate=options.rate)
    if options.port is not None and options.url is not None:
        raise ValueError("url is of another server, port of one that is opened: give one of them")
    if options.port is None and options.bind != Options.bind:
        raise ValueError("bind needs a port")
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as held:
        robot, url = make_robot(options), options.url or "ws://localhost:9090"
        if options.port is not None:  # after kernels are compiled: first come decides types of topics
            url = held.enter_context(contextlib.closing(RosbridgeServer(options.port, options.bind))).url
        bridge = held.enter_context(contextlib.closing(Rosbridge(url, options.namespace)))
        server = Server(options, bridge, robot)
        LOGGER.info("%s in %s, start %s, at %s", robot.robot.name, robot.world.name, robot.start, url)
        server.run(first_signal())


cli = functools.partial(run_program, main, Options)
"""Run `main` with options of the command line."""

if __name__ == "__main__":
    cli()
