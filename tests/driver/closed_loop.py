"""Times of a simulated robot that is driven through a rosbridge server, compared with those in an environment.

python -m tests.driver.closed_loop --starts 5 --speed 2

Starts, goals and policies are equal; noise and people differ. Server and session run in threads of one process.
"""

import contextlib
import logging
import math
import sys
import threading

import gymnasium
import numpy as np

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines import EXPLORERS, OFFERED
from lidarnaut.baselines.episode import run_episode
from lidarnaut.driver import drive, serve
from lidarnaut.driver.rosbridge import Rosbridge
from lidarnaut.driver.server import RosbridgeServer
from lidarnaut.envs.command_line import Count, run_command
from lidarnaut.envs.tasks.coverage import Coverage

WORLD, ROBOT, TARGET, TIME_LIMIT, MIN_DISTANCE = "turtlebot3_house", "turtlebot3_burger", 0.95, 600.0, 4.0


class Session(drive.Session):
    """Session that ends at the goal, at 95 % coverage, or at the time limit."""

    def __init__(self, options, bridge, robot):
        self.robot, self.is_over, self.seconds = robot, threading.Event(), math.inf
        self.coverage = Coverage(robot.area, robot.start, robot.robot.lidar)
        super().__init__(options, bridge)

    def step(self):
        command = super().step()
        if self.driver.has_begun and self.options.goal is None:
            belief = self.driver.belief
            self.coverage.update(belief.update, belief.grid.resolution, self.robot.reading.ranges, self.robot.pose)
        if self.reason == "reached" or self.coverage.explored_fraction >= TARGET:
            self.seconds = self.robot.time
        if self.seconds < math.inf or self.robot.time > TIME_LIMIT:
            self.is_over.set()
        if self.is_over.is_set() and self.seconds == math.inf:
            report(f"time limit, explored {self.coverage.explored_fraction:.3f}, last stop: {self.reason or 'none'}")
        return command


def drive_through_rosbridge(policy, people, seed, speed):
    """Return start pose, goal in the map frame (None for exploration) and time [s] of an episode."""
    with contextlib.ExitStack() as held:
        broker = held.enter_context(contextlib.closing(RosbridgeServer()))
        bridges = [held.enter_context(contextlib.closing(Rosbridge(broker.url))) for _ in range(2)]
        served = {"world": WORLD, "robot": ROBOT, "people": people, "start": "random", "seed": seed, "speed": speed}
        server = serve.Server(serve.Options(url=broker.url, **served), bridges[0])
        robot, goal, rng = server.robot, None, np.random.default_rng([seed, 1])
        while policy not in EXPLORERS and (goal is None or math.hypot(goal.x, goal.y) < MIN_DISTANCE):
            goal = robot.start.between(robot.area.draw_pose(rng))
        options = drive.Options(url=broker.url, use_sim_time=True, policy=policy, goal=goal and goal[:2])
        session = held.enter_context(contextlib.closing(Session(options, bridges[1], robot)))
        simulation = threading.Thread(target=server.run, args=(session.is_over,), daemon=True)
        simulation.start()
        held.callback(simulation.join)
        session.run(session.is_over)
        return robot.start, goal, session.seconds


def drive_in_environment(name, people, seed, start, goal):
    """Return the time of an episode [s]."""
    policy = parse_policy(name, EXPLORERS if goal is None else OFFERED["goal"])
    arguments = {"world": WORLD, "robot": ROBOT, "physics": "kinematic", "slam": "hector", "time_limit": TIME_LIMIT}
    arguments |= {"people": people or None, "start": tuple(start), **policy.arguments}
    if goal is None:
        env = gymnasium.make("lidarnaut/Explore-v0", target_coverage=TARGET, **arguments)
    else:
        env = gymnasium.make("lidarnaut/ReachGoal-v0", goal=goal[:2], **arguments)
    with contextlib.closing(env):
        episode = run_episode(env, policy.make(), seed)
    return episode.time_to_95 if goal is None else episode.time_to_goal


def report(line):
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(*, starts: Count = 5, speed: float = 1.0) -> None:
    """Print mean times through a rosbridge server and in an environment, and their ratio.

    Args:
        starts: number of starts for each policy.
        speed: simulated seconds per second.
    """
    logging.disable(logging.WARNING)
    for policy, people in (("pursuit", 0), ("mppi", 6)):
        times = []
        for seed in range(starts):
            start, goal, driven = drive_through_rosbridge(policy, people, seed, speed)
            times.append((driven, drive_in_environment(policy, people, seed, start, goal)))
            report(f"start {seed}: {times[-1][0]:.1f} s, environment {times[-1][1]:.1f} s")
        driven, usual = np.mean(times, axis=0)
        report(f"{policy}, {people} people, mean: {driven:.1f} s / {usual:.1f} s = {driven / usual:.2f}")


if __name__ == "__main__":
    run_command(main)
