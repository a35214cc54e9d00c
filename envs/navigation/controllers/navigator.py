"""Navigator: drives a robot along paths, triggers recovery behaviors, and reports progress.

Example:
    navigator = Navigator(robot, control_period)
    navigator.drive_to(path)                       # shape (n, 2), map frame [m]
    while navigator.update(reading, belief.pose) in (DRIVING, REPLAN):
        reading = drive(navigator.command(belief.pose))
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.estimation import Correction
from lidarnaut.envs.estimation.scan_points import ScanGeometry
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.navigation.controllers.navigator_kernels import (
    NAVIGATOR,
    check_progress,
    compute_velocity_command,
    navigator_numbers,
    recover,
    update_obstacles,
)
from lidarnaut.envs.navigation.controllers.regulated_pursuit import as_record
from lidarnaut.envs.navigation.maps.obstacles import BUMP_POINTS, MAX_REMEMBERED, NO_POINTS
from lidarnaut.envs.navigation.maps.planning_params import NavigatorParams
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

MAX_OTHERS = 256
"""Maximum number of obstacle points on other robots."""
NO_POSITION = (math.nan, math.nan)


class NavigatorArrays(NamedTuple):
    """State and constants of a navigator, as arguments of compiled functions."""

    records: np.ndarray
    path: np.ndarray
    obstacles: np.ndarray
    geometry: ScanGeometry
    numbers: np.ndarray


class Navigator:
    """Drives a robot along planned paths, with recovery behaviors."""

    def __init__(
        self,
        robot: RobotParams,
        control_period: float,
        params: NavigatorParams = NavigatorParams(),
        *,
        max_time: float = math.inf,
    ) -> None:
        """Create a navigator; `max_time`: time limit of a drive [s], not checked during recovery behaviors."""
        self._numbers = as_record(navigator_numbers(robot, control_period, max_time, params))
        self.numbers = self._numbers[0]
        self._geometry = ScanGeometry.of(robot.lidar)
        self._records = np.zeros(1, dtype=NAVIGATOR)
        self._obstacles = np.empty((MAX_REMEMBERED + BUMP_POINTS + robot.lidar.num_beams + MAX_OTHERS, 2))
        self._path = NO_POINTS
        self._period = control_period
        self.velocity = Twist(0.0, 0.0)
        self.motion = ORIGIN
        """Relative pose of the robot between its last two sensor readings, by odometry."""
        self.reset()

    def reset(self) -> None:
        """Forget path, obstacles and the last reading, as at the start of an episode."""
        self._odometry: Pose2D | None = None
        records = self._records
        records[:] = 0
        records["side"] = 1.0
        records["stall_steps"] = records["stuck_steps"] = -1
        records["forward"] = 1

    @property
    def record(self) -> Any:
        """State of the navigator, a record with the fields of `NAVIGATOR`; not a copy."""
        return self._records[0]

    @property
    def arrays(self) -> NavigatorArrays:
        return NavigatorArrays(self._records, self._path, self._obstacles, self._geometry, self._numbers)

    @property
    def plan(self) -> np.ndarray | None:
        """Remaining path, shape (n, 2), map frame [m]; None without a path."""
        return self._path[self.record["index"] :] if self.has_goal else None

    @property
    def has_goal(self) -> bool:
        return bool(self.record["has_goal"])

    @property
    def goal(self) -> tuple[float, float]:
        """Goal (x, y), map frame [m]."""
        return float(self.record["goal_x"]), float(self.record["goal_y"])

    @property
    def is_recovering(self) -> bool:
        return bool(self.record["back_steps"] > 0 or self.record["turn_steps"] > 0)

    def note_command(self, twist: Twist) -> None:
        """Record a velocity command sent instead of the result of `command`."""
        self.record["forward"] = int(twist.v >= 0.0)

    @property
    def visible(self) -> np.ndarray:
        """Points of the last scan, in the order of beams, shape (n, 2), float64, base frame [m]."""
        return self._obstacles[self.record["num_remembered"] : self.record["num_seen"]]

    @property
    def obstacles(self) -> np.ndarray:
        """Visible and remembered obstacle points, shape (n, 2), float64, base frame [m]."""
        return self._obstacles[: self.record["num_seen"]]

    def drive_to(
        self,
        path: np.ndarray,
        goal: tuple[float, float] | None = None,
        *,
        view: tuple[float, float] = NO_POSITION,
        keep_clocks: bool = False,
    ) -> None:
        """Begin a drive along a path to `goal` (x, y), by default the end of the path.

        `path`: shape (n, 2), n > 0, map frame [m]. `view`: position (x, y) to face at the goal. `keep_clocks`: continue
        the time limits of the last drive, so that new goals do not hide a stuck robot.
        """
        self._path = np.ascontiguousarray(path, dtype=np.float64)
        record = self.record
        record["index"], record["has_goal"] = 0, 1
        record["goal_x"], record["goal_y"] = goal or path[-1]
        record["view_x"], record["view_y"] = view
        if not keep_clocks:
            for name in ("steps", "recoveries", "back_steps", "turn_steps"):
                record[name] = 0
            record["stall_steps"] = -1
        record["planned"] = record["steps"]

    def follow(self, path: np.ndarray) -> None:
        """Replace the path of the current drive: shape (n, 2), n > 0, map frame [m]."""
        self._path = np.ascontiguousarray(path, dtype=np.float64)
        self.record["index"] = 0

    def follow_redrawn_map(self, correction: Correction | None) -> None:
        """Transform path, goal and the point to face at the goal by a map correction, such as a loop closure.

        The next `update` reports that replanning is due.
        """
        record, first = self.record, int(self.record["index"])
        record["planned"] = record["steps"] - self.numbers["replan_steps"]
        if correction is None or not self.has_goal:
            return
        self._path = np.concatenate([self._path[:first], correction.apply(self._path[first:])])
        for x, y in (("goal_x", "goal_y"), ("view_x", "view_y")):
            if math.isfinite(record[x]):
                record[x], record[y] = correction.apply(np.array([(record[x], record[y])]))[0]

    def spin(self, angle: float = 2.0 * math.pi) -> None:
        """Turn on the spot by an angle [rad], counter-clockwise, instead of driving."""
        rate = float(self.numbers["spin_rate"])
        for name in ("has_goal", "steps", "recoveries", "back_steps"):
            self.record[name] = 0
        self.record["turn_w"] = rate
        self.record["turn_steps"] = math.ceil(angle / rate / self._period)

    def recover(self) -> None:
        """Begin a recovery behavior: move opposite to the last command, or onward if there is more room, and spin."""
        record = self.record
        recover(self._records, self._obstacles[: record["num_obstacles"]], record["forward"] == 1, self._numbers)

    def stop(self) -> None:
        """Cancel the goal and any recovery behavior."""
        for name in ("has_goal", "back_steps", "turn_steps"):
            self.record[name] = 0

    def sense(self, reading: Reading, others: np.ndarray = NO_POINTS) -> None:
        """Update motion and obstacle points with a sensor reading; called by `update`.

        `others`: further obstacle points, such as other robots, shape (m, 2), float64, base frame [m].
        """
        self.motion = motion = reading.motion_since(self._odometry or reading.odometry)
        self._odometry = reading.odometry
        self.velocity = Twist(motion.x / self._period, motion.theta / self._period)
        state, sensors = (self._records, self._obstacles), (reading.ranges, self._geometry, reading.bumper)
        update_obstacles(*state, sensors, tuple(motion), others[:MAX_OTHERS], self._numbers)

    def update(self, reading: Reading, pose: Pose2D, others: np.ndarray = NO_POINTS) -> int:
        """Process a sensor reading; return the status of the drive, such as `DRIVING`.

        `pose`: pose estimate, map frame. `others`: further obstacle points, see `sense`.
        """
        self.sense(reading, others)
        return self.check_progress(pose, bumper=reading.bumper)

    def check_progress(self, pose: Pose2D, *, bumper: bool) -> int:
        """Check goal, motion and time limits; return the status of the drive, such as `DRIVING`."""
        return int(check_progress(self._records, self._obstacles, tuple(pose), bumper, self._numbers))

    def command(self, pose: Pose2D) -> Twist:
        """Return the next velocity command."""
        state = self._records, self._path, self._obstacles
        return Twist(*compute_velocity_command(*state, tuple(pose), self.velocity.v, self._numbers))
