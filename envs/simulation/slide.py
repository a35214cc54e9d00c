"""Slides: a robot that is moved along planned paths, without driving, and whose pose estimate drifts."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from lidarnaut.envs.arguments import check_positive, is_number
from lidarnaut.envs.geometry import ORIGIN, Pose2D, wrap_angle
from lidarnaut.envs.worlds import ExplorableArea, World

from .crowd.step import step_people
from .kinematic import KinematicSimulator
from .rows import Reading

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
DRIVEN = "lidarnaut/ExploreFrontiers-v0 with physics='kinematic'"


@dataclass(frozen=True)
class SlideParams:
    """Parameters of slides."""

    scan_distance: float = 0.4
    """Path length between scans [m]."""
    drift: tuple[float, float] = (0.03, 0.005)
    """Standard deviation of the estimated pose: position [m], heading [rad]."""
    false_returns: float = 0.0002
    """Fraction of beams that end early."""

    def __post_init__(self) -> None:
        check_positive(scan_distance=self.scan_distance)
        if np.shape(self.drift) != (2,) or not all(is_number(value) and value >= 0.0 for value in self.drift):
            raise ValueError(f"drift must be two non-negative numbers, got {self.drift!r}")
        if not 0.0 <= self.false_returns < 1.0:
            raise ValueError(f"false_returns must lie in [0, 1), got {self.false_returns!r}")


class Slide(KinematicSimulator):
    """Mover of one robot along planned paths, at typical speeds; wheels, contacts and scan matching are left out.

    The true pose is the estimated pose with a drifting error. A period of a slide lasts several control periods.
    """

    ignores = MappingProxyType(
        dict.fromkeys(("return_home", "people", "track_people", "sensors", "collision_monitor"), DRIVEN)
    )
    area: ExplorableArea
    """Explorable area of the world. Robots only slide to traversable true positions."""

    _pose: Pose2D | None = None  # estimate; None before the first period
    _map_pose: Pose2D

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        if self.robot.lidar.scan_time:
            raise ValueError(f"lidar.scan_time has no effect in slides; choose {DRIVEN}")
        self.params = SlideParams()
        self.is_blocked = False
        """Whether the robot stayed in the last period, because the true position would not be traversable."""
        self._speed, self._turn_rate = SPEED_SHARE * self.robot.max_v, TURN_SHARE * self.robot.max_w

    def reset(self, world: World, poses: Sequence[Pose2D], *args: Any) -> list[Reading]:
        self._error, self._pose = ORIGIN, None
        return super().reset(world, poses, *args)

    def aim(self, pose: Pose2D, count: int) -> None:
        """Set the estimated pose, map frame, that the next period moves the robot to in `count` control periods."""
        self._aim, self._count = pose, count

    def stops(
        self, start: Pose2D, plan: np.ndarray, max_steps: int
    ) -> tuple[Iterator[tuple[float, float, float, int]], bool]:
        """Return the poses of scans on a planned path, shape (n, 2), float64, map frame [m].

        `start`: estimated pose. `max_steps`: control periods after which the robot stops.

        Returns:
            Estimated poses [m, m, rad], map frame, with the number of control periods since the start; and whether the
            last one is the end of the path.
        """
        path = np.vstack([start[:2], plan])
        steps = path[1:] - path[:-1]
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
        headings, inner = np.arctan2(steps[:, 1], steps[:, 0]), lengths[1:-1]
        ahead = float(headings[np.searchsorted(inner, HEADING_DISTANCE)])
        turn = max(abs(wrap_angle(ahead - start.theta)) - MAX_ARC, 0.0) / self._turn_rate
        farthest = max((max_steps * self._period - turn) * self._speed, 0.0)
        end, spacing = min(float(lengths[-1]), farthest), self.params.scan_distance
        at_lengths = np.append(np.arange(spacing, end, spacing), end)
        xs, ys = (np.interp(at_lengths, lengths, values).tolist() for values in path.T)
        thetas = headings[np.searchsorted(inner, at_lengths)].tolist()
        counts = [max(round((turn + length / self._speed) / self._period), 1) for length in at_lengths.tolist()]
        return zip(xs, ys, thetas, counts, strict=True), bool(lengths[-1] <= farthest)

    def move(self) -> None:
        rows, row, rng, crowd = self.rows, self.rows.numbers[0], self.rngs[0], self.crowd
        if self._pose is None:
            self._pose, self._map_pose = (Pose2D(*row[name].tolist()) for name in ("pose", "map_pose"))
        pose, before = self._aim, self._pose
        kept = math.exp(-math.hypot(pose.x - before.x, pose.y - before.y) / DRIFT_LENGTH)
        renewed, (position_std, heading_std) = math.sqrt(1.0 - kept * kept), self.params.drift
        draws = zip(self._error, (position_std, position_std, heading_std), rng.standard_normal(3).tolist())
        self._error = error = Pose2D(*(kept * part + renewed * std * draw for part, std, draw in draws))
        true_pose = self._map_pose.compose(pose).compose(error)
        self.is_blocked = not self._is_free(true_pose)
        if self.is_blocked:
            true_pose = rows.state(0).pose
            pose = self._map_pose.between(true_pose.compose(error.inverse()))
        row["x"], row["y"], row["theta"], row["pose"] = *true_pose, pose
        self._pose = pose
        rows.go_to(rows.steps + self._count)
        for _ in range(self._count if len(crowd.rows) else 0):
            step_people(*crowd.arrays, rows.numbers)
        rows.draw([rng])
        self.sense()
        ranges = rows.ranges[0]
        if num_false := rng.binomial(len(ranges), self.params.false_returns):
            beams = rng.integers(len(ranges), size=num_false)
            ranges[beams] = np.fmin(ranges[beams], self.robot.lidar.range_max) * rng.random(len(beams))
        row["odometry"] = row["motion_settings"][0] = 0.0  # the pose estimate is that above
        row["key_pose"] = np.inf  # every scan is processed
        for name in ("least_gap", "least_time", "intrusion", "touched_by", "hits"):
            row[name] = np.nan  # not measured between scans

    def _is_free(self, pose: Pose2D) -> bool:
        (left, bottom), side = self.area.walls.origin, self.area.walls.resolution
        row, col = math.floor((pose.y - bottom) / side), math.floor((pose.x - left) / side)
        near = self.area.traversable[max(row - 1, 0) : max(row + 2, 0), max(col - 1, 0) : max(col + 2, 0)]
        return bool(near.any())
