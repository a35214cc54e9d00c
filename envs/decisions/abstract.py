"""Environment for frontier exploration without simulated driving."""

import math
from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from lidarnaut.envs.arguments import check_positive, is_number
from lidarnaut.envs.decisions.explore_frontiers import EPISODE_END, ExploreFrontiersEnv
from lidarnaut.envs.geometry import ORIGIN, Pose2D, wrap_angle
from lidarnaut.envs.navigation.controllers.navigator_kernels import DRIVING, FAILED, REACHED, SPUN, TIME_UP
from lidarnaut.envs.simulation import KinematicSimulator
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.crowd.step import step_people
from lidarnaut.envs.slam import KnownPoses
from lidarnaut.envs.task import COLUMNS

SPEED_SHARE = 0.97
"""Mean speed along a path, divided by the maximum speed."""
TURN_SHARE = 1.0
"""Mean yaw rate of a turn in place, divided by the maximum yaw rate."""
MAX_ARC = 1.6
"""Heading change at the start of a path that costs no time [rad]. Beyond it, the robot turns in place."""
HEADING_DISTANCE = 0.4
"""Distance along the path to the point that defines the initial heading [m]."""
DRIFT_LENGTH = 8.0
"""Correlation length of the pose error along the path [m]."""
DRIVEN = "lidarnaut/ExploreFrontiers-v0"
"""Id of the environment with simulated driving."""


class ExploreFrontiersAbstractEnv(ExploreFrontiersEnv):
    """Explore by choosing frontiers, with a robot that moves along planned paths.

    ## Description
    Decisions, candidates, map, lidar, worlds and reward are those of `ExploreFrontiersEnv`. The simulation is about
    twice as fast: the robot is moved along the planned path, and scans are integrated at intervals, at an estimated
    pose with a drifting error. Wheels, contacts, scan matching and recoveries are not simulated. Evaluate results in
    `ExploreFrontiersEnv`; docs/concepts/explore_frontiers.md compares both.

    ## Action Space
    As in `ExploreFrontiersEnv`.

    ## Observation Space
    As in `ExploreFrontiersEnv`.

    ## Rewards
    As in `ExploreFrontiersEnv`, without collisions.

    ## Starting State
    As in `ExploreFrontiersEnv`.

    ## Episode End
    As in `ExploreFrontiersEnv`.

    ## Arguments
    As in `ExploreFrontiersEnv`, without `return_home`, `people`, `track_people`, `sensors`, `collision_monitor` and
    lidars with a `scan_time`; `randomize` accepts lidar parameters only, and `reward` no speeds, actions or gaps to
    people.

    | argument | default | meaning |
    |---|---|---|
    | `physics` | `"kinematic"` | fixed |
    | `slam` | `"truth"` | fixed |
    | `map_resolution` | `0.2` | side of a map cell [m] |
    | `scan_distance` | `0.4` | path length between integrated scans [m] |
    | `drift` | `(0.03, 0.005)` | standard deviation of the estimated pose: position [m], heading [rad] |
    | `false_returns` | `0.0002` | fraction of beams that end early |

    ## Version History
    * v0: first version
    """

    ignores = dict.fromkeys(("return_home", "people", "track_people", "sensors", "collision_monitor"), DRIVEN)
    ignores |= ExploreFrontiersEnv.ignores

    def __init__(
        self,
        *,
        physics: str = "kinematic",
        slam: str = "truth",
        map_resolution: float = 0.2,
        scan_distance: float = 0.4,
        drift: tuple[float, float] = (0.03, 0.005),
        false_returns: float = 0.0002,
        **arguments: Any,
    ) -> None:
        for name, value, allowed in (("physics", physics, "kinematic"), ("slam", slam, "truth")):
            if value != allowed:
                raise ValueError(f"{name} must be {allowed!r} in this environment, got {value!r}")
        if others := [name for name in arguments.get("randomize") or () if not name.startswith("lidar.")]:
            raise ValueError(f"randomize must name only lidar parameters in this environment, got {others}")
        check_positive(scan_distance=scan_distance)
        if np.shape(drift) != (2,) or not all(is_number(value) and value >= 0.0 for value in drift):
            raise ValueError(f"drift must be two non-negative numbers, got {drift!r}")
        if not 0.0 <= false_returns < 1.0:
            raise ValueError(f"false_returns must lie in [0, 1), got {false_returns!r}")
        super().__init__(physics=physics, slam=slam, map_resolution=map_resolution, **arguments)
        if unknown := [name for name in self.explore.task.rewards.shared if name in COLUMNS]:
            raise ValueError(f"reward terms {unknown} have no effect in {type(self).__name__}; choose {DRIVEN}")
        if self.robot.lidar.scan_time:
            raise ValueError(f"lidar.scan_time has no effect in {type(self).__name__}; choose {DRIVEN}")
        robot, self._scan_distance, self._false_returns = self.robot, scan_distance, false_returns
        self._simulator = cast(KinematicSimulator, self.explore.simulator)
        self._mapping = cast(KnownPoses, self.explore.robots[0].estimator)
        self._drift = float(drift[0]), float(drift[0]), float(drift[1])
        self._speed, self._turn_rate = SPEED_SHARE * robot.max_v, TURN_SHARE * robot.max_w
        self._sees_around = bool(self.navigator.navigator.numbers["sees_around"])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self._error = ORIGIN
        started = super().reset(seed=seed, options=options)
        # Gaps to people of the world are not measured between scans.
        self.explore.rows.numbers[0, at.LEAST_GAP : at.HIT_BY_PERSON + 1] = math.nan
        # Scan obstacles do not move with the robot here: plan on the map only.
        record = self.navigator.navigator.record
        record["num_remembered"] = record["num_seen"] = record["num_obstacles"] = 0
        return started

    @property
    def why_not_fused(self) -> str:
        return "the robot is moved along planned paths"

    def _drive(self) -> str:
        explore, navigator = self.explore, self.navigator
        robot, plan = explore.robots[0], navigator.plan
        slide = None if plan is None else self._slide_along(plan)
        explore.plan = plan
        for pose, count, progress in slide or self._spin():
            if not self._scan(pose, count):
                progress = FAILED
            navigator.integrate(robot.belief)
            if any(explore.is_over):
                navigator.find_candidates(robot.reading, robot.belief)
                return EPISODE_END
            result = navigator.conclude(progress, robot.reading, robot.belief)
            if result is not None:
                return result
        return self._drive()

    def _slide_along(self, plan: np.ndarray) -> Iterator[tuple[Pose2D, int, int]]:
        start, period, record = self.belief.pose, self.explore.control_period, self.navigator.navigator.record
        max_steps = int(self.navigator.navigator.numbers["max_steps"])
        path = np.vstack([start[:2], plan])
        steps = path[1:] - path[:-1]
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
        headings, inner = np.arctan2(steps[:, 1], steps[:, 0]), lengths[1:-1]
        ahead = float(headings[np.searchsorted(inner, HEADING_DISTANCE)])
        turn = max(abs(wrap_angle(ahead - start.theta)) - MAX_ARC, 0.0) / self._turn_rate
        farthest = max((max_steps * period - turn) * self._speed, 0.0)
        end, before = min(float(lengths[-1]), farthest), 0
        stops = np.append(np.arange(self._scan_distance, end, self._scan_distance), end)
        xs, ys = (np.interp(stops, lengths, values).tolist() for values in path.T)
        for stop, x, y, heading in zip(stops.tolist(), xs, ys, headings[np.searchsorted(inner, stops)].tolist()):
            count = max(round((turn + stop / self._speed) / period), 1)
            record["steps"], progress = count, DRIVING
            if stop == end:
                progress = REACHED if lengths[-1] <= farthest else TIME_UP
            if progress == REACHED and not self._sees_around:
                target = self.navigator.target or (x, y)
                heading = math.atan2(target[1] - y, target[0] - x) - self.robot.lidar.mount.yaw
            yield Pose2D(x, y, wrap_angle(heading)), count - before, progress
            before = count

    def _spin(self) -> Iterator[tuple[Pose2D, int, int]]:
        navigator, (x, y, theta) = self.navigator.navigator, self.belief.pose
        navigator.stop()
        parts = 1 if self._sees_around else max(4, math.ceil(2.0 * math.pi / self.robot.lidar.fov))
        count = math.ceil(2.0 * math.pi / float(navigator.numbers["spin_rate"]) / self.explore.control_period / parts)
        for k in range(parts):
            heading = wrap_angle(theta + 2.0 * math.pi * (k + 1) / parts)
            yield Pose2D(x, y, heading), count, SPUN if k == parts - 1 else DRIVING

    def _scan(self, pose: Pose2D, count: int) -> bool:
        """Place the robot at an estimated pose after `count` control periods, and process a scan.

        Returns False, without motion, if the true pose would not be free.
        """
        explore = self.explore
        simulator, robot, truth = self._simulator, explore.robots[0], explore.truths[0]
        rows, rng, before = simulator.rows, simulator.rngs[0], robot.belief.pose
        kept = math.exp(-math.hypot(pose.x - before.x, pose.y - before.y) / DRIFT_LENGTH)
        renewed = math.sqrt(1.0 - kept * kept)
        draws = zip(self._error, self._drift, rng.standard_normal(3).tolist(), strict=True)
        self._error = error = Pose2D(*(kept * part + renewed * std * draw for part, std, draw in draws))
        true_pose = explore.map_pose.compose(pose).compose(error)
        is_free = self._is_free(true_pose)
        if not is_free:
            true_pose = truth.state.pose
            pose = explore.map_pose.between(true_pose.compose(error.inverse()))
        rows.numbers[0, at.X : at.THETA + 1] = true_pose
        rows.go_to(rows.steps + count)
        for _ in range(count if len(simulator.crowd.rows) else 0):
            step_people(*simulator.crowd.arrays, rows.numbers)
        rows.draw([rng])
        simulator.sense()
        ranges = robot.ranges
        if num_false := rng.binomial(len(ranges), self._false_returns):
            beams = rng.integers(len(ranges), size=num_false)
            ranges[beams] = np.fmin(ranges[beams], self.robot.lidar.range_max) * rng.random(len(beams))
        truth.update()
        robot.follow(self._mapping.process_key_scan(ranges, pose))
        explore.update_task()
        self._note(count, 0)
        return is_free

    def _is_free(self, pose: Pose2D) -> bool:
        area = self._task.coverage.area
        (left, bottom), side = area.walls.origin, area.walls.resolution
        row, col = math.floor((pose.y - bottom) / side), math.floor((pose.x - left) / side)
        return bool(area.traversable[max(row - 1, 0) : max(row + 2, 0), max(col - 1, 0) : max(col + 2, 0)].any())
