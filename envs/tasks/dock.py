import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import is_number, is_pose
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import DOCK
from lidarnaut.envs.navigation.goals.docking import DOCK_GAP
from lidarnaut.envs.observations import Battery
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import ObservationPart
from lidarnaut.envs.worlds import World
from lidarnaut.envs.worlds.world import box, edges, kept_with_world

from .navigate import Navigate, NavigateBrief

DEPTH, WIDTH = 0.1, 0.3
"""Size of a charging station along and across its heading [m]."""
MAX_SPEED = 0.01
"""Maximum speed of a docked robot [m/s]."""


@dataclass(kw_only=True, eq=False)
class DockBrief(NavigateBrief):
    """Brief of `Dock`, without the battery, which no message measures."""

    goal_tolerance: float = 0.02
    heading_tolerance: float = math.radians(3.0)


@dataclass(kw_only=True, eq=False)
class Dock(DockBrief, Navigate):
    """Dock at a charging station on a known map.

    ## Description
    A robot drives to a charging station on a known map, and stops in front of the station within 2 cm and 3 degrees. A
    localizer updates the pose estimate in each step (one control period). Observations contain no ground truth.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits.

    ## Observation Space
    `Dict`, egocentric:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | as in `Explore` |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 8 m x 8 m around the estimated pose, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | known map, 32 m x 32 m around the estimated pose, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | as in `Explore` |
    | `goal` | `Box(-1, 1, (5,), float32)` | docked pose, as in `Navigate`: distance / 32 m, cosine and sine of bearing and heading difference |
    | `pose_uncertainty` | `Box(0, 1, (3,), float32)` | standard deviations of position / 1 m and heading / pi (at most 1), 1 if the localizer is lost |
    | `battery` | `Box(0, 1, (2,), float32)` | charge (1 is full), 1 while charging |

    Map channels as in `Explore`.

    ## Rewards
    As in `Navigate`; `reached` (10, once, when docked and charged). `reward` changes the weights.

    ## Starting State
    As in `Navigate`. `goal="random"` draws one of the world's `docks`; other goals are poses of the docked robot. Each
    dock has a station of 0.1 m x 0.3 m. The charge is drawn uniformly from `start_charge`.

    ## Episode End
    1. Termination: the robot is docked (its true pose is within both tolerances of the goal, at rest), with a charge of
       at least `target_charge`.
    2. Termination: the battery is empty.
    3. Truncation: `time_limit` seconds have passed.

    The battery loses charge with time and distance (`BatteryParams` of the robot), and gains charge while the robot is
    docked. Collisions do not end the episode.

    ## Information
    As in `Navigate`, and `heading_error` (to the docked pose) [rad], `charge`, `is_docked`; `end_reason` is `"docked"`,
    `"empty"` or `"time_limit"`.

    ## Arguments
    The arguments of `Navigate` (`min_distance` excludes near docks, unless all are near), and

    | argument | default | meaning |
    |---|---|---|
    | `goal_tolerance` | `0.02` | distance from the docked pose that counts as docked [m] |
    | `heading_tolerance` | `radians(3)` | heading difference that counts as docked [rad] |
    | `start_charge` | `(0.1, 0.3)` | range of the charge at the start |
    | `target_charge` | `0.0` | charge that ends the episode; 0 for docking alone |

    ## Version History
    * v0: first version
    """

    measures = DOCK

    start_charge: tuple[float, float] = (0.1, 0.3)
    target_charge: float = 0.0

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        charge = self.start_charge
        if not (is_pose(charge, 2) and 0 < charge[0] <= charge[1] <= 1):
            raise ValueError(f"start_charge must be (low, high) with 0 < low <= high <= 1, got {self.start_charge!r}")
        if not (is_number(self.target_charge) and 0 <= self.target_charge <= 1):
            raise ValueError(f"target_charge must lie in [0, 1], got {self.target_charge!r}")
        super().attach(robot, control_period, physics)
        self.needs_explorable = False  # only with the stations
        charged = f", and charges to {100.0 * self.target_charge:g} %" if self.target_charge else ""
        self.success_condition = f"the robot docks within {100.0 * self.goal_tolerance:g} cm{charged}"

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        return {**super().observation_parts(), "battery": partial(Battery, self)}

    def place(self, world: World, start: Any) -> World:
        return with_stations(super().place(world, start))

    def _draw_goal(self, rng: np.random.Generator) -> Pose2D:
        start, docks = self._true_pose, self._world.docks
        if not docks:
            known = "choose tugbot_warehouse, aws_small_house or a world file with docks, or set goal"
            raise ValueError(f"world {self._world.name!r} has no docks; {known}")
        goals = [dock.compose(Pose2D(-self.robot.radius - DOCK_GAP, 0.0, 0.0)) for dock in docks]
        distances = [math.dist(goal[:2], start[:2]) for goal in goals]
        least = min(self._min_distance, max(distances))
        far = [goal for goal, away in zip(goals, distances, strict=True) if away >= least]
        return far[rng.integers(len(far))]

    def _usual_time(self, length: float) -> float:
        battery = self.robot.battery  # full charging time, since the drive discharges
        charging_time = 3600.0 * battery.capacity * self.target_charge / battery.charging_power
        return super()._usual_time(length) + 60.0 + charging_time

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        time_limit = super().reset(simulator, robots, rng, options)
        self.charge, self.is_docked = float(rng.uniform(*self.start_charge)), False
        return time_limit

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        super().update(simulator, robots, period)
        battery, (robot,) = self.robot.battery, robots
        self.is_docked = self._is_at_goal() and abs(simulator.states[0].twist.v) <= MAX_SPEED
        power = -battery.idle_power - battery.energy_per_metre * abs(robot.twist.v)
        power = battery.charging_power if self.is_docked else power
        self.charge = min(max(self.charge + power * period / (3600.0 * battery.capacity), 0.0), 1.0)
        measured = {**robot.reading.extra, "battery": np.array([self.charge, self.is_docked])}
        robot.reading = robot.reading._replace(extra=measured)
        is_done = self.is_docked and self.charge >= self.target_charge
        self.end_reason = "docked" if is_done else None if self.charge > 0.0 else "empty"
        self._quantities["reached"] = float(is_done)

    def metrics(self) -> dict[str, Any]:
        own = {"charge": self.charge, "is_docked": self.is_docked, "is_success": self.end_reason == "docked"}
        return {**super().metrics(), "heading_error": abs(self._true_pose.between(self._true_goal).theta), **own}


@kept_with_world
def with_stations(world: World) -> World:
    """Return a world with a solid charging station at each of its docks."""
    centers = [dock.compose(Pose2D(0.5 * DEPTH, 0.0, 0.0)) for dock in world.docks]
    stations = [edges(box(x, y, DEPTH, WIDTH, theta)) for x, y, theta in centers]
    return replace(world, segments=np.vstack([world.segments, *stations]))
