"""Sessions on a simulated robot, without a server."""

import threading
import time
from collections import deque

from lidarnaut.driver import drive
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.logs import messages


class Topics:
    """Connection without a server: `publish` of a message calls its subscriber, and keeps the last message."""

    error = ""

    def __init__(self):
        self.receivers, self.last = {}, {}
        self.waiting = None
        """Messages that wait for `spin`; None to receive them at once."""

    def advertise(self, topic, kind, *, latch=False):
        pass

    def subscribe(self, topic, kind, receive):
        self.receivers[topic] = receive

    def publish(self, topic, message):
        self.last[topic] = message
        if topic in self.receivers:
            if self.waiting is None:
                self.receivers[topic](message)
            else:
                self.waiting.append((topic, message))

    def spin(self):
        while self.waiting:
            topic, message = self.waiting.popleft()
            self.receivers[topic](message)


class Drive:
    """A session on a simulated robot. `transforms`: messages of `/tf_static`; by default those of its lidar."""

    def __init__(self, *transforms, robot=None, **options):
        self.robot, self.topics = robot or SimulatedRobot("turtlebot3_world", rate=10.0, start="spawn"), Topics()
        self.session = drive.Session(
            drive.Options(**{"policy": "pursuit", "use_sim_time": True, **options}), self.topics
        )
        for each in transforms or [messages.static_transforms(self.robot.robot.lidar.mount)]:
            self.topics.publish("/tf_static", each)

    def sensed(self):
        """Return the messages of a control period by topic."""
        robot = self.robot
        return {
            "/clock": messages.clock(robot.time),
            "/odom": messages.odometry(robot.time, robot.odometry, robot.twist),
            "/scan": messages.laser_scan(robot.time, robot.reading.ranges, robot.robot.lidar, 0.1),
        }

    def publish(self, sensed=None):
        for topic, message in (sensed or self.sensed()).items():
            self.topics.publish(topic, message)

    def step(self, steps=1, sensed=None):
        for _ in range(steps):
            self.publish(sensed)
            self.robot.step(self.session.step())

    def run(self, seconds, **how):
        """Run the session's loop, and the robot at full speed beside it."""
        is_over, ends = threading.Event(), self.robot.time + seconds
        self.topics.waiting = deque()

        def simulate():
            while not is_over.is_set() and self.robot.time < ends:
                self.publish()
                self.robot.step(drive.STOP)
                time.sleep(0.002)
                while len(self.topics.waiting) > 30 and not is_over.is_set():  # the first decision compiles
                    time.sleep(0.002)
            is_over.set()

        thread = threading.Thread(target=simulate)
        thread.start()
        try:
            return self.session.run(is_over, **how)
        finally:
            is_over.set()
            thread.join()
