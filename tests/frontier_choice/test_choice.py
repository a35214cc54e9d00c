"""No choice traps a robot: what it cannot get to is noticed, remembered and no longer offered."""

import math

import numpy as np
import pytest

from envs.frontier_choice import OUTCOMES, OVER, FrontierChoice, act, judge
from envs.frontier_choice.nearby import frontier_near
from envs.frontier_choice.params import PilotParams
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import load_robot

BURGER = load_robot("turtlebot3_burger")
PERIOD = 0.2


class Robot:
    """A robot in a room of 4 m x 2 m with one door; it stands as if held, or drives exactly as commanded."""

    def __init__(self, choice, *, held=False, bumping=False, seconds=math.inf):
        data = np.full((60, 80), -1, dtype=np.int8)
        data[:40] = 0
        data[:2] = data[38:40] = 100
        data[:40, :2] = data[:40, -2:] = 100
        data[38:44, 56:72] = 0
        self.grid = OccupancyGrid(data, 0.05, (0.0, 0.0))
        self.pose = Pose2D(1.0, 1.0, 0.0)
        self.time = 0.0
        self.commands = []
        self._choice, self._held, self._bumping, self._seconds = choice, held, bumping, seconds

    def drive(self):
        choice, command = self._choice, np.zeros(2, dtype=np.float32)
        blind = np.full(BURGER.lidar.num_beams, np.inf, dtype=np.float32)
        while self.time < self._seconds:
            act(choice.pilot[0], choice.path, choice.obstacles, *self.pose, 0.1, choice.numbers, command)
            self.commands.append(command.copy())
            v, w = (0.0, 0.0) if self._held else command * (BURGER.max_v, BURGER.max_w)
            turn = Pose2D(v * PERIOD * math.cos(0.5 * w * PERIOD), v * PERIOD * math.sin(0.5 * w * PERIOD), w * PERIOD)
            self.pose = self.pose.compose(turn)
            self.time += PERIOD
            choice.sense(blind, v, w, self._bumping)
            frame = (self.grid.data, 0.05, *self.grid.origin, choice.block, choice.given_up)
            code = judge(choice.pilot[0], choice.obstacles, *self.pose, self._bumping, *frame, choice.numbers)
            if code:
                return code
        return OVER


def make_choice(max_time=60.0):
    directions = np.vstack([np.cos(BURGER.lidar.angles), np.sin(BURGER.lidar.angles)])
    return FrontierChoice(BURGER, PERIOD, 0.05, directions, max_candidates=5, max_time=max_time)


def decide(choice, robot, action=0):
    return OUTCOMES[choice.decide(action, robot)]


def test_a_robot_arrives_and_what_it_cannot_see_there_is_given_up():
    choice = make_choice()
    robot = Robot(choice)
    choice.survey(robot)
    assert choice.mask.tolist() == [1, 0, 0, 0, 0]
    assert decide(choice, robot) == "arrived"
    goal = choice.pilot[0]
    assert math.hypot(goal["goal_x"] - robot.pose.x, goal["goal_y"] - robot.pose.y) <= 0.2
    # The map has not changed: looking at this frontier is of no use, and there is no other.
    assert len(choice.given_up)
    assert choice.mask.sum() == 0
    assert choice.end_reason == "no_reachable_frontier"


def test_what_lies_behind_a_wall_is_not_given_up():
    choice = make_choice()
    robot = Robot(choice)
    # Right of where the robot looks out of the door, a wall, and a nook with a frontier of its own.
    robot.grid.data[38:46, 66:74] = 100
    robot.grid.data[40:46, 68:74] = 0
    choice.survey(robot)
    frontier = choice.places[0, 2:]
    assert decide(choice, robot) == "arrived"
    radius = math.dist(robot.pose[:2], frontier) + 3.0 * BURGER.radius
    nook = frontier_near(robot.grid.data, 0.0, 0.0, 0.05, choice.block, *robot.pose[:2], radius, np.empty((0, 2)))
    assert nook[:, 0].max() > 3.4
    assert len(choice.given_up)
    assert choice.given_up[:, 0].max() < 3.4


def test_a_robot_that_is_held_fails_backs_off_and_is_rid_of_what_it_fails_to_reach():
    choice = make_choice()
    robot = Robot(choice, held=True)
    choice.survey(robot)
    for failures in range(8):
        if not choice.mask.any():
            break
        if failures < 3:
            assert choice.features[0, 8] == pytest.approx(failures / 3)
            assert len(choice.given_up) == 0
        before = robot.time
        assert decide(choice, robot) == "failed"
        # Stuck for ten seconds, besides the manoeuvres in between.
        assert 9.0 < robot.time - before < 30.0
    assert min(command[0] for command in robot.commands) < 0.0
    # The frontier is longer than what is given up at once, but not by much.
    assert 3 <= failures < 8
    assert not choice.mask.any()
    assert choice.end_reason == "stuck"


def test_a_robot_that_can_stand_nowhere_on_its_map_is_stuck():
    choice = make_choice()
    robot = Robot(choice)
    robot.grid.data[10:30, 10:30] = 100
    choice.survey(robot)
    assert not choice.mask.any()
    assert decide(choice, robot) == "looked_around"
    assert choice.end_reason == "stuck"


def test_a_frontier_that_is_chosen_late_does_not_fail_at_once():
    choice = make_choice(max_time=4.0)
    robot = Robot(choice, held=True)
    choice.survey(robot)
    outcomes, times = [], []
    for _ in range(4):
        before = robot.time
        outcomes.append(decide(choice, robot))
        times.append(robot.time - before)
    # Stuck after ten seconds, in the midst of the third drive or the manoeuvre before.
    assert outcomes[:2] == ["time_up", "time_up"]
    assert "failed" in outcomes
    assert min(times) > 4.0 - PERIOD


def test_bumping_again_and_again_fails():
    choice = make_choice()
    robot = Robot(choice, held=True, bumping=True)
    choice.survey(robot)
    assert decide(choice, robot) == "failed"
    assert robot.time < 20.0


def test_a_look_around_ends_though_the_robot_is_bumped_again_and_again():
    choice = make_choice()
    robot = Robot(choice, held=True, bumping=True, seconds=200.0)
    robot.grid.data[robot.grid.data < 0] = 100
    choice.survey(robot)
    assert not choice.mask.any()
    assert decide(choice, robot) == "looked_around"
    assert robot.time < 20.0


def test_a_drive_ends_when_its_time_is_up_and_when_the_episode_does():
    choice = make_choice(max_time=2.0)
    robot = Robot(choice)
    choice.survey(robot)
    assert decide(choice, robot) == "time_up"
    assert robot.time == pytest.approx(2.0)
    assert choice.features[0, 9] == 1.0
    choice = make_choice()
    robot = Robot(choice, seconds=1.0)
    choice.survey(robot)
    assert decide(choice, robot) == "episode_end"


def test_a_frontier_that_is_gone_ends_the_drive_after_a_second():
    choice = make_choice()
    robot = Robot(choice)
    choice.survey(robot)
    robot.grid.data[robot.grid.data < 0] = 100
    assert decide(choice, robot) == "frontier_gone"
    # A second, and the turn on the spot in search of others.
    assert robot.time == pytest.approx(1.0 + 2.0 * math.pi / PilotParams().spin_rate, abs=2 * PERIOD)


def test_a_way_that_is_closed_fails_when_it_is_planned_anew():
    choice = make_choice()
    robot = Robot(choice)
    choice.survey(robot)
    robot.grid.data[36:38, 2:78] = 100
    assert decide(choice, robot) == "failed"
    assert robot.time < 5.0 + 8.0
