"""Commands of a driver for recorded messages, to count instructions.

valgrind --tool=callgrind --callgrind-out-file=/dev/null python -m tests.driver.instructions POLICY COUNT

The difference between two counts, divided by the difference of `COUNT`, is the number per command at 10 Hz, with five
odometry messages and a scan. The first run, without valgrind, records the messages.
"""

import json
import tempfile
from pathlib import Path

import numpy as np

from lidarnaut.agents.policies import make_policy
from lidarnaut.driver import Driver
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.command_line import Count, run_command
from tests.driver.loop import Loop

WORLD, ROBOT = "turtlebot3_house", "turtlebot3_burger"


class Recorded(Driver):
    """Driver that keeps its messages."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.calls = []

    def scan(self, ranges, stamp, delays=None):
        self.calls.append(("scan", ranges.tolist(), stamp))
        super().scan(ranges, stamp, delays=delays)

    def odometry(self, pose, stamp):
        self.calls.append(("odometry", pose, stamp))
        super().odometry(pose, stamp)

    def goal(self, *goal):
        self.calls.append(("goal", *map(float, goal)))
        super().goal(*goal)

    def command(self, stamp):
        self.calls.append(("command", stamp))
        return super().command(stamp)


def record(policy, people):
    """Return the calls of a minute of driving: method and arguments."""
    robot, rng = SimulatedRobot(WORLD, ROBOT, people=people), np.random.default_rng(0)
    driver = Recorded(make_policy(policy), ROBOT, slam="hector")

    def watch():
        if driver.env.task.goal is not None and driver.reason in ("no goal yet", "reached"):
            driver.goal(*robot.start.between(robot.area.draw_pose(rng))[:2])
        return False

    Loop(driver, robot).run(60.0, watch)
    return driver.calls


def main(policy: str, count: Count, /) -> None:
    """Repeat the first `count` commands of a recorded drive."""
    kept = Path(tempfile.gettempdir()) / f"lidarnaut_{policy.replace(':', '_').replace('/', '_')}.json"
    if not kept.exists():
        kept.write_text(json.dumps(record(policy, 6 if "crowd" in policy else None)))
    driver = Driver(make_policy(policy), ROBOT, slam="hector")
    for name, *arguments in json.loads(kept.read_text()):
        getattr(driver, name)(*arguments)
        count -= name == "command"
        if not count:
            break


if __name__ == "__main__":
    run_command(main)
