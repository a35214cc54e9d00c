"""Pure pursuit, regulated by curvature, by obstacles and by the remaining distance.

After Macenski, Singh, Martin, Gines: "Regulated Pure Pursuit for Robot Path Tracking" (2023), with Nav2's numbers where
they do not depend on the robot's speed. Two things differ. Obstacles come from the scan itself rather than from a
costmap, so that stops do not depend on the pose estimate. And where the arc to the carrot is blocked, the
carrot is pulled in before the robot slows down, so that lookahead does not cut corners.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.navigation.obstacles import free_distance, points_within
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Twist

BEND_CHORD = 5
"""Points of the path between which its direction is measured."""
NEAREST_WINDOW = 40
"""Points among which the nearest one is looked for: a second of driving at full speed is as far as it can have moved
on, with some to spare."""
NUM_SQUEEZES, SQUEEZE_STEP = 5, 0.1
"""Number of directions that are tried on either side of the carrot in narrow passages, and their distance [rad]."""
FOLLOWER_FIELDS = [("index", np.int64), ("side", np.float64), ("rotating", np.int64)]
"""What a follower remembers from one command to the next: the path's point nearest to the robot, the side on which it
last steered past something (1 left, -1 right), and whether it is turning on the spot."""


@dataclass(frozen=True, slots=True)
class FollowerParams:
    """How to follow a path. Speeds are fractions of the robot's limits where they must suit every robot."""

    lookahead_time: float = 1.5
    """Lookahead over speed [s]."""
    min_lookahead: float = 2.0
    """Least lookahead, in radii of the robot and at most 0.25 m."""
    max_lookahead: float = 0.9
    """Greatest lookahead [m]."""
    rotate_from: float = 0.785
    """Angle to the carrot from which the robot turns on the spot first [rad]."""
    rotate_until: float = 0.3
    """Angle at which it drives on [rad]."""
    max_rotation: float = 1.8
    """Greatest yaw rate [rad/s]; scan matching suffers from faster ones."""
    min_turn_time: float = 1.8
    """Arcs whose radius is driven through in less than this at full speed are driven more slowly [s]."""
    min_speed: float = 0.35
    """Least speed to which curvature and nearness slow the robot down, as a fraction of the limit."""
    nearness_time: float = 0.6
    """Obstacles nearer to the footprint than is driven in this time at full speed slow the robot down [s]."""
    margin: float = 0.4
    """Distance that is kept between footprint and obstacles, in radii of the robot and at most 0.03 m. From it 1.5
    standard deviations of the lidar's noise are taken: the nearest of a wall's many points lies that much too near."""
    sidesteps: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)
    """Angles by which the robot steers past obstacles between it and the carrot, on either side [rad]."""
    braking: float = 0.5
    """Share of the robot's greatest deceleration that braking counts on."""


FAST = FollowerParams(
    lookahead_time=0.6,
    max_lookahead=1.2,
    rotate_from=1.2,
    max_rotation=4.0,
    min_turn_time=0.6,
    min_speed=0.25,
    nearness_time=0.3,
)
"""For robots of some m/s that turn fast, and do not match scans; tuned in the family `clutter`."""


def follower_numbers(
    robot: RobotParams, period: float, params: FollowerParams = FollowerParams()
) -> dict[str, float | tuple[float, ...]]:
    """Return the numbers of a robot that is commanded every `period` seconds, for `as_record`; in m, s and rad."""
    braking_v = params.braking * robot.max_acc_v
    return asdict(params) | {
        "period": period,
        "radius": robot.radius,
        "max_v": robot.max_v,
        "max_w": robot.max_w,
        "rotation": min(robot.max_w, params.max_rotation),  # greatest yaw rate that is used
        "braking_v": braking_v,  # deceleration that braking counts on
        "braking_w": params.braking * robot.max_acc_w,
        # Radius that is kept free of obstacles.
        "reach": robot.radius + min(params.margin * robot.radius, 0.03) - 1.5 * robot.lidar.noise_std,
        # The same where a passage leaves no more.
        "tight_reach": robot.radius - robot.lidar.noise_std,
        "min_lookahead": min(params.min_lookahead * robot.radius, 0.25),
        # Least length of an arc that is tested: what braking from full speed takes.
        "look": robot.max_v * period + 0.5 * robot.max_v**2 / braking_v + 0.03,
    }


def as_record(numbers: Mapping[str, float | tuple[float, ...]]) -> np.ndarray:
    """Return numbers and tuples of numbers as a structured array of float64, shape (1,).

    Handing an array to a compiled function takes 0.3 us, a named tuple 0.1 us for each number in it.
    """
    fields = [(name, np.float64, np.shape(value)) for name, value in numbers.items()]
    return np.array([tuple(numbers.values())], dtype=record_type(fields))


@njit(cache=True, error_model="numpy")
def nearest_index(path, x, y, first, window):
    """Return the index of the path's point nearest to (x, y), looking at `window` points from `first` on."""
    best, best_squared = first, np.inf
    for k in range(first, min(first + window, path.shape[0])):
        squared = (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2
        if squared < best_squared:
            best, best_squared = k, squared
    return best


@njit(cache=True, error_model="numpy")
def _carrot_index(path, x, y, first, lookahead):
    """Return the index of the first point from `first` on at least `lookahead` [m] from (x, y), or of the last."""
    for k in range(first, path.shape[0]):
        if (path[k, 0] - x) ** 2 + (path[k, 1] - y) ** 2 >= lookahead * lookahead:
            return k
    return path.shape[0] - 1


@njit(cache=True, error_model="numpy")
def _distance_to_bend(path, first, chord, angle):
    """Return the length of the path from index `first` to where it bends by more than `angle` [rad], or to its end [m].

    Directions are those of chords of `chord` points, so that the staircase of a raster does not count as bends.
    """
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
    """Return the yaw rate that turns on the spot by `angle` [rad], slowing down in time to stop there [rad/s]."""
    rate = min(math.sqrt(2.0 * numbers.braking_w * abs(angle)), 0.5 * abs(angle) / numbers.period)
    return math.copysign(min(rate, numbers.rotation), angle)


@njit(cache=True, error_model="numpy")
def _free(x, y, lookahead, reach, obstacles, numbers):
    """Return how far the arc to a point (base frame [m]) is free, looking at least as far as braking takes [m]."""
    curvature = 2.0 * y / max(x * x + y * y, 1e-6)
    return free_distance(obstacles, curvature, reach, max(lookahead, numbers.look))


@njit(cache=True, error_model="numpy")
def _sidestep(state, x, y, free, obstacles, numbers):
    """Return a point beside the carrot whose arc is free, on the side taken last if possible; else as `_squeeze`."""
    for offset in numbers.sidesteps:
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
    """Return the point about the carrot whose arc keeps most distance from obstacles, if one without a margin is free.

    So the robot takes the middle of a passage that is hardly wider than itself. Without such an arc, the carrot.
    """
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
    """Return the mean distance from obstacles along the arc to a point, as far as it is below that to keep [m]."""
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
    """Return the point to steer for, base frame [m], and how far its arc is free [m]."""
    c, s = math.cos(theta), math.sin(theta)
    while True:
        k = _carrot_index(path, x, y, state.index, lookahead)
        dx, dy = path[k, 0] - x, path[k, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        free = _free(ahead, left, lookahead, numbers.reach, obstacles, numbers)
        if free >= lookahead:
            return ahead, left, free
        if lookahead <= numbers.min_lookahead:
            return _sidestep(state, ahead, left, free, obstacles, numbers)
        lookahead = max(0.6 * lookahead, numbers.min_lookahead)


@njit(cache=True, error_model="numpy")
def _speed_for(free, numbers):
    """Return the greatest speed from which the robot stops within `free` metres, one period of delay included."""
    delay = numbers.braking_v * numbers.period
    return math.sqrt(delay**2 + 2.0 * numbers.braking_v * max(free, 0.0)) - delay


@njit(cache=True, error_model="numpy")
def _approach_speed(ahead, left, obstacles, numbers):
    """Return the speed towards a point (base frame [m]) at which any gap to an obstacle lasts for `nearness_time`.

    A gap closes by the speed's component towards the obstacle: walls beside the way do not count, what lies on it does.
    """
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
    """Return the forward speed [m/s] along the arc to a point (base frame [m]), of which `free` metres are free."""
    max_v, slowest = numbers.max_v, numbers.min_speed
    curvature = 2.0 * left / (ahead**2 + left**2)
    v = max_v * min(1.0, max(1.0 / (max(abs(curvature), 1e-6) * max_v * numbers.min_turn_time), slowest))
    v = min(v, max(_approach_speed(ahead, left, obstacles, numbers), slowest * max_v))
    # To turn on the spot at a bend, or to stop at the end, the robot must have braked before.
    bend = _distance_to_bend(path, state.index, BEND_CHORD, numbers.rotate_from)
    v = min(v, max(_speed_for(bend, numbers), slowest * max_v))
    return min(v, _speed_for(free, numbers))


@njit(cache=True, error_model="numpy")
def follow(state, path, x, y, theta, v_now, obstacles, numbers):
    """Choose the twist that follows a path for the next period.

    `state` is a record with `FOLLOWER_FIELDS`, written; `path` has the shape (n, 2), float64, n > 0, points up to a map
    cell apart, map frame [m]; `x`, `y`, `theta` are estimated, `v_now` is the forward speed by odometry [m/s];
    `obstacles` have the shape (k, 2), float64, base frame [m]. Returns forward speed [m/s], yaw rate [rad/s], and
    whether obstacles keep the robot from driving on.
    """
    state.index = nearest_index(path, x, y, state.index, NEAREST_WINDOW)
    lookahead = numbers.lookahead_time * max(abs(v_now), numbers.min_speed * numbers.max_v)
    lookahead = min(max(lookahead, numbers.min_lookahead), numbers.max_lookahead)
    # No arc that is tested leads farther away than it is long.
    near = points_within(obstacles, max(lookahead, numbers.look) + numbers.reach)
    ahead, left, free = _carrot(state, path, x, y, theta, lookahead, near, numbers)
    angle = math.atan2(left, ahead)
    if abs(angle) > (numbers.rotate_until if state.rotating else numbers.rotate_from):
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


class PathFollower:
    """Drives along one path at a time; a `LocalPlanner`."""

    def __init__(self, robot: RobotParams, control_period: float, params: FollowerParams = FollowerParams()) -> None:
        """Prepare for a robot; `control_period` is the time between two calls of `command` [s]."""
        self._numbers = as_record(follower_numbers(robot, control_period, params))[0]
        self._state = np.zeros(1, dtype=record_type(FOLLOWER_FIELDS))
        self._state["side"] = 1.0
        self._path = np.empty((0, 2))
        self.blocked = False
        """Whether the last command did not drive on because of obstacles."""

    @property
    def remaining(self) -> np.ndarray:
        """The rest of the path, shape (n, 2), map frame [m]."""
        return self._path[self._state["index"][0] :]

    def set_path(self, path: np.ndarray) -> None:
        """Follow another path from now on; see `LocalPlanner`."""
        self._path = np.ascontiguousarray(path)
        self._state["index"] = 0

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the twist to command for the next period; see `LocalPlanner`."""
        v, w, self.blocked = follow(self._state[0], self._path, *pose, twist.v, obstacles, self._numbers)
        return Twist(v, w)
