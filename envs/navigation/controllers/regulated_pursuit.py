"""Regulated pure pursuit: curvature, obstacles and remaining distance limit the speed.

After Macenski, Singh, Martin, Gines: "Regulated Pure Pursuit for Robot Path Tracking" (2023). Unlike in Nav2, obstacles
come from the scan, so stops do not depend on the pose estimate. A blocked arc shortens the lookahead distance, to avoid
cutting corners.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.navigation.controllers.local_planner import LocalPlanner
from lidarnaut.envs.navigation.maps.obstacles import free_distance, points_within
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

BEND_CHORD = 5
"""Number of path segments over which the path direction is measured, to slow down before bends."""
NEAREST_WINDOW = 40
"""Number of path points searched for the point nearest to the robot."""
ROTATE_UNTIL = 0.3
"""Angle to the lookahead point below which a turn on the spot ends [rad]."""
MAX_MIN_LOOKAHEAD, MAX_MARGIN = 0.25, 0.03
"""Upper limits of the minimum lookahead distance (2 robot radii) and of the safety margin (0.4 robot radii) [m]."""
BRAKING_SHARE = 0.5
"""Fraction of maximum deceleration assumed for braking."""
SIDESTEPS = (0.2, 0.4, 0.6, 0.8)
"""Rotations of the lookahead point to either side, tried to steer past obstacles [rad]."""
NUM_SQUEEZES, SQUEEZE_STEP = 5, 0.1
"""Number and spacing [rad] of directions tried on either side of the lookahead point in narrow passages."""
FOLLOWER_FIELDS = [("index", np.int64), ("side", np.float64), ("rotating", np.int64)]
"""Path follower state: index of the nearest path point, last sidestep (1 left, -1 right), whether turning in place."""


@dataclass(frozen=True, slots=True)
class FollowerParams:
    """Parameters of regulated pure pursuit."""

    lookahead_time: float = 1.5
    """Lookahead distance divided by speed [s]."""
    max_lookahead: float = 0.9
    """Maximum lookahead distance [m]."""
    rotate_from: float = 0.785
    """Angle to the lookahead point above which the robot turns on the spot [rad]."""
    max_rotation: float = 1.8
    """Maximum yaw rate [rad/s]; faster turns degrade scan matching."""
    min_turn_time: float = 1.8
    """Speed limit in curves: the turning radius divided by this time [s]."""
    min_speed: float = 0.35
    """Minimum speed near obstacles and in curves, as a fraction of maximum speed."""
    nearness_time: float = 0.6
    """Minimum time to close the gap to an obstacle [s]; limits the speed near obstacles."""


FAST = FollowerParams(
    lookahead_time=0.6,
    max_lookahead=1.2,
    rotate_from=1.2,
    max_rotation=4.0,
    min_turn_time=0.6,
    min_speed=0.25,
    nearness_time=0.3,
)
"""Parameters for fast robots without scan matching, tuned on the world family `clutter`."""


def follower_numbers(robot: RobotParams, period: float, params: FollowerParams = FollowerParams()) -> dict[str, float]:
    """Return robot and path follower constants for compiled functions; `period`: control period [s]."""
    braking_v = BRAKING_SHARE * robot.max_acc_v
    return asdict(params) | {
        "period": period,
        "radius": robot.radius,
        "max_v": robot.max_v,
        "max_w": robot.max_w,
        "rotation": min(robot.max_w, params.max_rotation),
        "braking_v": braking_v,
        "braking_w": BRAKING_SHARE * robot.max_acc_w,
        "reach": robot.radius + min(0.4 * robot.radius, MAX_MARGIN) - 1.5 * robot.lidar.noise_std,
        # In narrow passages.
        "tight_reach": robot.radius - robot.lidar.noise_std,
        "min_lookahead": min(2.0 * robot.radius, MAX_MIN_LOOKAHEAD),
        # Minimum length of tested arcs: braking distance from full speed.
        "look": robot.max_v * period + 0.5 * robot.max_v**2 / braking_v + 0.03,
    }


def as_record(numbers: Mapping[str, float | tuple[float, ...]]) -> np.ndarray:
    """Convert a mapping of numbers and tuples to a structured float64 array, shape (1,), for compiled functions."""
    fields = [(name, np.float64, np.shape(value)) for name, value in numbers.items()]
    return np.array([tuple(numbers.values())], dtype=record_type(fields))


@njit(cache=True, error_model="numpy")
def nearest_index(path, x, y, first, window):
    """Return the index of the path point nearest to (x, y), among `window` points from `first` on."""
    best, best_squared = first, np.inf
    for k in range(first, min(first + window, path.shape[0])):
        squared = (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2
        if squared < best_squared:
            best, best_squared = k, squared
    return best


@njit(cache=True, error_model="numpy")
def _distance_to_bend(path, first, chord, angle):
    last = path.shape[0] - 1
    ahead = min(first + chord, last)
    direction = math.atan2(path[ahead, 1] - path[first, 1], path[ahead, 0] - path[first, 0])
    length = 0.0
    for k in range(first, last - chord):
        turn = math.atan2(path[k + chord, 1] - path[k, 1], path[k + chord, 0] - path[k, 0]) - direction
        if abs((turn + math.pi) % (2.0 * math.pi) - math.pi) > angle:
            break
        length += math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
    return length


@njit(cache=True, error_model="numpy")
def turn_rate(angle, numbers):
    """Return the yaw rate [rad/s] for a turn on the spot by `angle` [rad] with time to brake."""
    rate = min(math.sqrt(2.0 * numbers.braking_w * abs(angle)), 0.5 * abs(angle) / numbers.period)
    return math.copysign(min(rate, numbers.rotation), angle)


@njit(cache=True, error_model="numpy")
def _free(x, y, lookahead, reach, obstacles, numbers):
    curvature = 2.0 * y / max(x * x + y * y, 1e-6)
    return free_distance(obstacles, curvature, reach, max(lookahead, numbers.look))


@njit(cache=True, error_model="numpy")
def _sidestep(state, x, y, free, obstacles, numbers):
    for offset in SIDESTEPS:
        for side in (state.side, -state.side):
            c, s = math.cos(side * offset), math.sin(side * offset)
            beside_x, beside_y = c * x - s * y, s * x + c * y
            free_beside = _free(beside_x, beside_y, numbers.min_lookahead, numbers.reach, obstacles, numbers)
            if free_beside >= numbers.min_lookahead:
                state.side = side
                return beside_x, beside_y, free_beside
    return _squeeze(x, y, free, obstacles, numbers)


@njit(cache=True, error_model="numpy")
def _squeeze(x, y, free, obstacles, numbers):
    most, found = -np.inf, (x, y, free)
    for k in range(-NUM_SQUEEZES, NUM_SQUEEZES + 1):
        c, s = math.cos(SQUEEZE_STEP * k), math.sin(SQUEEZE_STEP * k)
        beside_x, beside_y = c * x - s * y, s * x + c * y
        free_beside = _free(beside_x, beside_y, numbers.min_lookahead, numbers.tight_reach, obstacles, numbers)
        if free_beside < numbers.min_lookahead:
            continue
        room = _room(beside_x, beside_y, obstacles, numbers)
        if room > most:
            most, found = room, (beside_x, beside_y, free_beside)
    return found


@njit(cache=True, error_model="numpy")
def _room(x, y, obstacles, numbers):
    angle, total = math.atan2(y, x), 0.0
    for share in (0.25, 0.5, 0.75, 1.0):
        chord = math.hypot(x, y) * (math.sin(angle * share) / math.sin(angle) if abs(angle) > 1e-3 else share)
        on_x, on_y = chord * math.cos(angle * share), chord * math.sin(angle * share)
        nearest = numbers.reach**2
        for k in range(obstacles.shape[0]):
            nearest = min(nearest, (obstacles[k, 0] - on_x) ** 2 + (obstacles[k, 1] - on_y) ** 2)
        total += math.sqrt(nearest)
    return 0.25 * total


@njit(cache=True, error_model="numpy")
def _carrot(state, path, x, y, theta, lookahead, obstacles, numbers):
    c, s = math.cos(theta), math.sin(theta)
    while True:
        k, last = state.index, path.shape[0] - 1
        while k < last and (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2 < lookahead * lookahead:
            k += 1
        dx, dy = path[k, 0] - x, path[k, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        free = _free(ahead, left, lookahead, numbers.reach, obstacles, numbers)
        if free >= lookahead:
            return ahead, left, free
        if not lookahead > numbers.min_lookahead:
            return _sidestep(state, ahead, left, free, obstacles, numbers)
        lookahead = max(0.6 * lookahead, numbers.min_lookahead)


@njit(cache=True, error_model="numpy")
def _speed_for(free, numbers):
    delay = numbers.braking_v * numbers.period
    return math.sqrt(delay**2 + 2.0 * numbers.braking_v * max(free, 0.0)) - delay


@njit(cache=True, error_model="numpy")
def _approach_speed(ahead, left, obstacles, numbers):
    distance = math.hypot(ahead, left)
    v = np.inf
    for k in range(obstacles.shape[0]):
        x, y = obstacles[k, 0], obstacles[k, 1]
        towards = (x * ahead + y * left) / distance
        if towards > 0.0:
            away = math.hypot(x, y)
            v = min(v, (away - numbers.radius) * away / (numbers.nearness_time * towards))
    return v


@njit(cache=True, error_model="numpy")
def _regulated_speed(state, path, ahead, left, free, obstacles, numbers):
    max_v, slowest = numbers.max_v, numbers.min_speed
    curvature = 2.0 * left / (ahead**2 + left**2)
    v = max_v * min(1.0, max(1.0 / (max(abs(curvature), 1e-6) * max_v * numbers.min_turn_time), slowest))
    v = min(v, max(_approach_speed(ahead, left, obstacles, numbers), slowest * max_v))
    # Brake before a turn on the spot at a bend, and before the end.
    bend = _distance_to_bend(path, state.index, BEND_CHORD, numbers.rotate_from)
    v = min(v, max(_speed_for(bend, numbers), slowest * max_v))
    return min(v, _speed_for(free, numbers))


@njit(cache=True, error_model="numpy")
def follow(state, path, x, y, theta, v_now, obstacles, numbers):
    """Return the next command on a path: forward speed [m/s], yaw rate [rad/s], and True if blocked by obstacles.

    `state`: record with `FOLLOWER_FIELDS`, updated. `path`: points up to a map cell apart, shape (n, 2), n > 0, map
    frame [m]. `x`, `y`, `theta`: pose estimate. `v_now`: forward speed by odometry [m/s]. `obstacles`: shape (k, 2),
    base frame [m].
    """
    state.index = nearest_index(path, x, y, state.index, NEAREST_WINDOW)
    # In this order, NaN counts as the minimum speed.
    lookahead = numbers.lookahead_time * max(numbers.min_speed * numbers.max_v, abs(v_now))
    lookahead = min(max(lookahead, numbers.min_lookahead), numbers.max_lookahead)
    near = points_within(obstacles, max(lookahead, numbers.look) + numbers.reach)
    ahead, left, free = _carrot(state, path, x, y, theta, lookahead, near, numbers)
    angle = math.atan2(left, ahead)
    if abs(angle) > (ROTATE_UNTIL if state.rotating else numbers.rotate_from):
        state.rotating = 1
        return 0.0, turn_rate(angle, numbers), False
    state.rotating = 0
    distance = math.hypot(ahead, left)
    if distance < 1e-3:
        return 0.0, 0.0, False
    curvature = 2.0 * left / distance**2
    v = _regulated_speed(state, path, ahead, left, free, obstacles, numbers)
    if v < 0.02 * numbers.max_v:
        return 0.0, turn_rate(angle, numbers) if abs(angle) > 0.1 else 0.0, True
    w = v * curvature
    if abs(w) > numbers.rotation:
        v, w = v * numbers.rotation / abs(w), math.copysign(numbers.rotation, w)
    return v, w, False


class PathFollower(LocalPlanner):
    """Local planner that uses regulated pure pursuit."""

    def __init__(self, robot: RobotParams, control_period: float, params: FollowerParams = FollowerParams()) -> None:
        self._numbers = as_record(follower_numbers(robot, control_period, params))[0]
        self._state = np.zeros(1, dtype=record_type(FOLLOWER_FIELDS))
        self._state["side"] = 1.0

    @property
    def remaining(self) -> np.ndarray:
        return self._path[self._state["index"][0] :]

    def set_path(self, path: np.ndarray) -> None:
        super().set_path(path)
        self._state["index"] = 0

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        v, w, self.blocked = follow(self._state[0], self._path, *pose, twist.v, obstacles, self._numbers)
        return Twist(v, w)
