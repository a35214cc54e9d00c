"""Exploration: map an unknown world."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import is_number
from lidarnaut.envs.estimation import NO_UPDATE
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.measures import EXPLORATION, RETURN
from lidarnaut.envs.observations import Home, Peers
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.task import ObservationPart

from .coverage import Coverage, map_iou
from .starts import UnknownWorldTask

HOME_RADIUS = 0.3
"""Distance between the robot's true position and its start at which it has returned [m]."""
MAX_ROBOTS = 4
"""Robots of a team at most."""


@dataclass(kw_only=True, eq=False)
class Explore(UnknownWorldTask):
    """Explore an unknown world with a lidar robot.

    ## Description
    A differential-drive robot with a 2D lidar and wheel encoders starts in a world that it has no map of. Each step drives
    it for one control period; then a SLAM turns the new scan and the motion by odometry into a map and a pose. The policy
    sees what the robot senses and estimates, never ground truth. The task is to explore the whole world.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: forward speed and yaw rate (counter-clockwise) as fractions of the robot's limits. Actions
    outside are an error, or clipped with `clip_actions=True`, as unbounded Gaussian policies need.

    ## Observation Space
    `Dict`, everything seen from the robot (fresh arrays each step); `observations` chooses the parts:

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_beams,), float32)` | range over the lidar's greatest range; 1 no return; 0 beam lost or obstacle too near |
    | `map_near` | `Box(0, 255, (3, 40, 40), uint8)` | map, 8 m x 8 m around the robot, 0.2 m per pixel |
    | `map_far` | `Box(0, 255, (3, 40, 40), uint8)` | map, 32 m x 32 m around the robot, 0.8 m per pixel |
    | `motion` | `Box(-1, 1, (6,), float32)` | forward speed and yaw rate by odometry over the limits, last action (2), bumper pressed (0 or 1), time since the reset over 600 s (at most 1) |
    | `plan` (not by default) | `Box(-1, 1, (27,), float32)` | paths to the three frontiers that are worth most, nine numbers for each: directions 0.3 m, 0.6 m and 1.5 m ahead on the path (cosine, sine), cost, unknown area in view, 1; see `lidarnaut.envs.observations.Plan` |

    Map channels: 0 occupied, 1 free, 2 where the robot has been by its own estimate. Axis 1 points forward, axis 2 to the left. Unknown is 0 in
    channels 0 and 1.

    ## Rewards
    The sum of the terms in `info["rewards"]`: `explored` (1 per m2 of explorable cells that became explored: the map knows
    the cell where it is, and the true scan that made it known, or a later one, has seen it; a map that is displaced or bent
    gains nothing), `time` (-0.02 per s), `collision` (-0.5 per s in contact with anything), `completed` (10, once, when the
    target coverage is reached); with `return_home=True` also `returned` (10, once). `reward` changes the weights.

    ## Starting State
    The robot is at rest and has no map yet. `start="random"` draws its pose uniformly over where it fits, clear of
    people on fixed routes, `start="spawn"` takes the world's first spawn pose, a tuple `(x, y, theta)` is taken as it is. Procedural
    families draw a new world at each reset. `reset(options={"world": ..., "start": ...})` chooses for one episode.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    Collisions cost, and do not end the episode.

    With `return_home=True` the target coverage ends exploration, not the episode: the robot is called back to its start,
    and termination is when it is within 0.3 m of it, by ground truth. The default observation then has a part `home`,
    `Box(-1, 1, (4,), float32)`: 1 once the robot is called back, distance to the start by its own estimate over 32 m,
    cosine and sine of the bearing; and the reward a term `returned`.

    ## Information
    Each step: `explored_fraction` (of the explorable area), `explored_area` [m2], `pose_error` (position [m],
    heading [rad]), `path_length` [m], `collisions` (contacts so far), `time` [s], `rewards` (terms), `is_success`; at the
    end also `map_iou`, `area_left` (explorable and unknown) [m2] and `end_reason` (`"covered"` or `"time_limit"`). With `return_home=True` each step also
    `returned` and `time_home` (since the robot was called back) [s]; `end_reason` is `"returned"` in place of `"covered"`,
    and `is_success` asks for both. With `randomize` each step also `randomized`: what the episode has drawn, by name.

    ## Arguments
    Those that all tasks share (see `LidarEnv`), and

    | argument | default | meaning |
    |---|---|---|
    | `world` | `"turtlebot3_world"` | library world, procedural family (such as `rooms`), path of a world YAML or of a `map_server` YAML, or a `World`; or a list of these, one of which is drawn for each episode |
    | `slam` | `"hector"` | `"hector"`, `"tinyslam"`, `"graph"` (loop closures) and `"gmapping"` for one robot, `"odometry"` (maps at the pose by odometry), `"truth"` (maps at the true pose), or a SLAM of your own, see `lidarnaut.envs.slam.make_slam` |
    | `target_coverage` | `0.99` | explored fraction that ends the episode |
    | `start` | `"random"` | see Starting State |
    | `split` | `"train"` | which seeds of a procedural family: `"train"` or `"test"` |
    | `world_size` | `None` | outer size (x, y) of a procedural world [m]; `None` leaves it to the family |
    | `difficulty` | `None` | of the worlds of `clutter`, from 0 to 1; `None` draws it for each |
    | `num_worlds` | `None` | how many worlds a procedural family has, each of which is made once, which makes resets faster; `None` draws without end |
    | `reward` | `None` | weights of the reward terms that are to be others, by name, or a subclass of `lidarnaut.envs.task.Rewards` |
    | `map_resolution` | `0.05` | side of a map cell [m] |
    | `return_home` | `False` | whether the robot is to come back to its start after exploring, see Episode End; for one robot |

    ## Version History
    * v0: first version
    """

    measures = EXPLORATION
    progress = "explored_fraction"
    weights = {"explored": 1.0, "time": -0.02, "collision": -0.5, "completed": 10.0}

    target_coverage: float = 0.99
    return_home: bool = False

    @property
    def rests_between_scans(self) -> bool:  # type: ignore[override]
        """True but for robots that return, and for subclasses of the user's own; see `Task`."""
        return type(self) in (Explore, ExploreTeam) and not self.return_home

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        """Check the arguments; see `Task`."""
        if not (is_number(self.target_coverage) and 0 < self.target_coverage <= 1):
            raise ValueError(f"target_coverage must lie in (0, 1], got {self.target_coverage!r}")
        if self.return_home and self.num_robots > 1:
            raise ValueError("return_home is for one robot, not for a team")
        if self.return_home:
            self.measures = (*EXPLORATION, *RETURN)  # type: ignore[assignment,misc]
            self.weights = {**self.weights, "returned": 10.0}
        self.is_returning = False
        """Whether the robot is to come back to its start now; with `return_home=True` alone."""
        super().attach(robot, control_period, physics)

    def observation_parts(self) -> Mapping[str, Callable[..., ObservationPart]]:
        """Return the start as "home" and the peers of a team as "teammates"; see `Task`."""
        parts: dict[str, Callable[..., ObservationPart]] = {}
        if self.return_home:
            parts["home"] = partial(Home, self)
        if self.num_robots > 1:
            parts["teammates"] = partial(Peers, self.num_robots - 1)
        return parts

    def call_back(self) -> None:
        """End exploration where no frontier is left, and call the robot back to its start.

        Raises:
            ValueError: without `return_home=True`.
        """
        if not self.return_home:
            raise ValueError("the robot can be called back with return_home=True alone")
        self.is_returning = True

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Start an episode; see `Task`."""
        self.coverage = Coverage(self.area, self.map_pose, simulator.robot.lidar)
        """The true coverage."""
        for robot, pose in zip(robots, self.starts, strict=True):
            self._cover(robot, pose)
        self.end_reason = None
        self.is_returning = self._is_covered = False
        self._time_home, self._robots = 0.0, robots
        return self.area.usual_time_limit(self.robot.max_v)

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Count what was explored, and see whether that is all; see `Task`."""
        self._time_home += period * self.is_returning
        gained = 0.0
        for k, robot in enumerate(robots):
            if robot.belief.update is not NO_UPDATE:
                gained += self._cover(robot, simulator.states[k].pose)
        is_covered = self.coverage.explored_fraction >= self.target_coverage
        self._quantities = {
            "explored": gained,
            "time": period,
            "collision": period * sum(robot.bumper for robot in robots),
            "completed": float(is_covered and not self._is_covered),
        }
        self._is_covered |= is_covered
        if not self.return_home:
            self.end_reason = "covered" if is_covered else None
            return
        self.is_returning |= is_covered
        (x, y, _), (home_x, home_y, _) = simulator.states[0].pose, self.map_pose
        if self.is_returning and math.hypot(x - home_x, y - home_y) <= HOME_RADIUS:
            self.end_reason = "returned"
        self._quantities["returned"] = float(self.end_reason == "returned")

    def quantities(self) -> dict[str, float]:
        """Return explored area [m2], time [s], time in contact [s] of all robots, and what was achieved just now."""
        return self._quantities

    def metrics(self) -> dict[str, Any]:
        """Return how much is explored, and whether the robot has returned and how long that took; see `Task`."""
        fraction = self.coverage.explored_fraction
        metrics = {"explored_fraction": fraction, "explored_area": self.coverage.explored_area}
        if not self.return_home:
            return metrics | {"is_success": fraction >= self.target_coverage}
        returned = self.end_reason == "returned"
        return metrics | {
            "is_success": self._is_covered and returned,
            "returned": returned,
            "time_home": self._time_home,
        }

    def final_metrics(self) -> dict[str, Any]:
        """Return the agreement of the map with the visible walls, and the area that is not explored [m2]."""
        area = self.coverage.area
        left = area.area - self.coverage.explored_area
        return {"map_iou": map_iou(self._robots[0].belief.grid, area, self.map_pose), "area_left": left}

    def _cover(self, robot: Robot, true_pose: Pose2D) -> float:
        belief = robot.belief
        return self.coverage.update(belief.update, belief.grid.resolution, robot.ranges, true_pose)


@dataclass(kw_only=True, eq=False)
class ExploreTeam(Explore):
    """Explore an unknown world with a team of lidar robots that share one map.

    ## Description
    `Explore` with one to four equal robots. They start near each other and know their relative poses, as in
    Umari and Mukhopadhyay (2017). Each tracks its own pose, by matching its scans to the map that all of them integrate
    their scans into. They see each other, and they collide with each other. Beams that end at a peer, by the poses that the
    robots tell each other, are left out of the map. With one robot everything equals `Explore`.

    ## Action Space
    `Box(-1, 1, (num_robots, 2), float32)`: a row per robot, forward speed and yaw rate (counter-clockwise) as fractions
    of its limits.

    ## Observation Space
    `Dict`, a row per robot of what `Explore` shows, everything seen from that robot (fresh arrays each step):

    | key | space | meaning |
    |---|---|---|
    | `scan` | `Box(0, 1, (num_robots, num_beams), float32)` | ranges, peers among what they hit |
    | `map_near` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 8 m x 8 m around each robot |
    | `map_far` | `Box(0, 255, (num_robots, 3, 40, 40), uint8)` | the shared map, 32 m x 32 m around each robot |
    | `motion` | `Box(-1, 1, (num_robots, 6), float32)` | each robot's own motion, last action, bumper, time since the reset over 600 s (at most 1) |
    | `teammates` | `Box(-1, 1, (num_robots, 4 * (num_robots - 1)), float32)` | four numbers for each of the others, in the order of their indices: estimated position ahead and to the left over 16 m, cosine and sine of the heading; only with two or more robots |

    Channel 2 of the maps shows where any of the robots has been.

    ## Rewards
    The sum of the terms in `info["rewards"]`, which are those of `Explore` for the team as a whole: `explored` (each
    cell once, by whichever robot), `time`, `collision` (for each robot that touches anything, peers included), `completed`.

    ## Starting State
    The robots are at rest and have no map yet; the frame of their map begins where robot 0 starts. `start` says where
    that is, as in `Explore`; the others start within 2 m of it, in its line of sight and 0.5 m apart, with any heading,
    or, where there is no room for that, further away, closer together, or out of its line of sight. One pose per robot,
    `((x, y, theta), ...)`, is taken as it is.

    ## Episode End
    1. Termination: the explored fraction reaches `target_coverage`.
    2. Truncation: `time_limit` seconds have passed.

    ## Information
    That of `Explore`, of which `pose_error`, shape (num_robots, 2), `path_length` and `collisions` have a row per robot.

    ## Arguments
    Those of `Explore` but for `return_home`, and

    | argument | default | meaning |
    |---|---|---|
    | `num_robots` | `2` | robots, 1 to 4 |
    | `start` | `"random"` | also a pose for each robot, see Starting State |

    ## Version History
    * v0: first version
    """

    is_team = True

    num_robots: int = 2

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        """Check the arguments; see `Task`."""
        if self.num_robots not in range(1, MAX_ROBOTS + 1):
            raise ValueError(f"num_robots must be a whole number from 1 to {MAX_ROBOTS}, got {self.num_robots!r}")
        super().attach(robot, control_period, physics)
