"""Example of a user's module outside of the package: tests copy it to a folder and name its parts."""

import sys
from dataclasses import replace

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.slam import KnownPoses, load_params
from lidarnaut.envs.task import Rewards
from lidarnaut.envs.worlds import load_world


class Circling:
    end_reason = None
    plan = None

    def reset(self, robot, control_period, rng):
        self.v = 0.5 * robot.max_v

    def act(self, reading, belief):
        return Twist(self.v, 0.6 if np.nanmin(reading.ranges) < 0.4 else 0.1)


class Spy(Circling):
    def reveal(self, coverage, target_coverage):
        self.coverage = coverage


class Admits(Circling):
    """Explorer with ground truth from elsewhere, which it declares."""

    uses_ground_truth = True


class Truth:
    """Observation part that shows the true pose and declares it."""

    uses_ground_truth = True

    def space(self, robot):
        return spaces.Box(-np.inf, np.inf, (3,), np.float64)

    def write(self, robot, out, truth):
        out[:] = truth.state.pose


class SeesTruth:
    observations = {"truth": Truth}

    def __call__(self, observation):
        return np.array([0.5, np.cos(observation["truth"][2])])


class FollowsTruth:
    """Policy that observes the true shortest path, by a part of the package."""

    observations = {"carrot": {"path": "shortest"}}

    def __call__(self, observation):
        return np.array([0.5, observation["carrot"][1]])


class FollowsPlan(FollowsTruth):
    observations = {"carrot": {"path": "plan"}}


def shown(observation):
    return np.array([0.5, 0.1])


class Leaving(Circling):
    """Exits the process at its second decision."""

    count = 0

    def act(self, reading, belief):
        self.count += 1
        if self.count > 1:
            sys.exit("done")
        return super().act(reading, belief)


def ahead(observation):
    """Policy of twists: fractions of the limits, here beyond them."""
    return np.array([3.0, 0.3 * np.sign(observation["scan"][90] - observation["scan"][270])])


class Model:
    """Policy with the interface of stable-baselines3."""

    def predict(self, observation, deterministic=False):
        return np.array([0.7, 0.2], dtype=np.float32), None


def first_frontier(observation):
    """Policy of decisions: the candidate with the lowest path cost."""
    return 0


first_frontier.level = "decision"


class MaskedModel:
    """Policy of decisions with the interface of sb3-contrib."""

    level = "decision"

    def predict(self, observation, deterministic=False, action_masks=None):
        gains = np.where(action_masks, observation["candidates"][:, 0], -1.0)
        return np.argmax(gains), None


WORLD = replace(load_world("pimouse_arena"), name="mine")
ROBOT = replace(load_robot("raspimouse"), name="my_mouse")


def my_slam(lidar, resolution):
    return KnownPoses(lidar, load_params("default", {"resolution": resolution}))


class Failing(KnownPoses):
    def __init__(self, lidar, resolution):
        super().__init__(lidar, load_params("default", {"resolution": resolution}))

    def update(self, reading, motion):
        raise TypeError("no numbers")


def leave(*_):
    sys.exit(3)


def guess(candidates, belief):
    """Frontier rule with a field that candidates lack."""
    return candidates["gain"] / candidates["cost"]


def first_two(candidates, belief):
    return np.zeros(2 * len(candidates))


def unknown(candidates, belief):
    return np.full(len(candidates), np.nan)


class Unread(Circling):
    def act(self, reading, belief):
        return Twist(reading.speed, 0.0)


class NanReward(Rewards):
    def terms(self, quantities):
        return {"half": quantities["time"] * np.nan}
