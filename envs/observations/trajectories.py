"""Observation of the predicted motions by candidate velocity commands (twists)."""

import math

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_clusters import CLUSTER_SIZE
from lidarnaut.envs.estimation.scan_points import BODY_MARGIN, ScanGeometry, beam_end, is_on_body
from lidarnaut.envs.estimation.tracking import (
    MAX_CLUSTERS,
    MAX_TRACKS,
    SENSITIVE_TRACKER,
    TRACK_SIZE,
    num_kept_scans,
    track_people,
    tracker_numbers,
    write_bodies,
)
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.task import RowPart

SPEEDS = -0.3, 0.0, 0.15, 0.3, 0.65, 1.0
"""Forward speeds of candidate velocity commands, fractions of the maximum."""
TURNS = -1.0, -0.65, -0.4, -0.225, -0.1, 0.0, 0.1, 0.225, 0.4, 0.65, 1.0
"""Yaw rates of candidate velocity commands, fractions of the maximum."""
FINE_SPEEDS, FINE_TURNS = tuple(sorted((*SPEEDS, -0.015, 0.015, 0.04, 0.08))), tuple(sorted((*TURNS, -0.03, 0.03)))
"""Forward speeds and yaw rates of the fine candidates, for stops within 1 cm, fractions of the maxima."""
TWISTS, FINE_TWISTS = (
    np.array([(v, w) for v in speeds for w in turns], dtype=np.float32)
    for speeds, turns in ((SPEEDS, TURNS), (FINE_SPEEDS, FINE_TURNS))
)
"""Candidate velocity commands: fractions of maximum speed and yaw rate, shape (66, 2) and (130, 2), float32."""
NUMBERS, END, TURN = 8, slice(4, 6), 6
"""Number of features per velocity command; indices of the predicted end position and of the heading change."""
HOLD, STEP, HORIZON = 0.5, 0.125, 3.0
"""Duration of a velocity command, time step of the collision check, and prediction horizon [s]."""
LINE_TIME = 1.0
"""Closeness to walls is predicted for this duration of straight driving after a velocity command [s]."""
NEAR_WALL, NEAR_PERSON, DECAY_TIME = 0.4, 0.8, 1.5
"""Closeness to a wall or a person is 0 from this distance of the footprint [m]; time constant of the decay of closeness
to people that the robot meets later [s]."""
SMALL_GAP = 0.1
"""Gap to walls that is normalized to 1 [m]; larger gaps are clipped."""
MAX_POINTS, MAX_RANGE = 120, 6.0
"""Maximum number and maximum range [m] of lidar end points that count as walls."""
MIN_WALKING_SPEED = 0.5
"""People slower than this count as walls [m/s]."""
WALL_MARGIN = 0.02
"""Safety margin around the footprint in predicted wall contacts [m]; smaller if the robot is already closer."""
REAR_ANGLE = 0.35
"""The lidar sees the rear if a beam is within this angle of the backward direction [rad]."""
STATE, STEPS = 9, 8
NUM_STEPS = int(HOLD / STEP)
DECAYS = tuple(math.exp(-(step + 1) * STEP / DECAY_TIME) for step in range(NUM_STEPS))
"""Weights of closeness to people at each step of a velocity command."""
FAST = {"nnan", "reassoc", "contract"}  # infinity is used


@njit(cache=True, error_model="numpy")
def find_walls(ranges, geometry, people, points):
    """Write points on walls, seen by a scan, to `points`, shape (2, MAX_POINTS), base frame [m]; return their number.

    Each group of adjacent beams gives its nearest end point, unless on a walking person. `people`: x, y, vx, vy,
    radius, shape (m, 5), base frame [m, m/s].
    """
    num_beams, count = ranges.shape[0], 0
    walking = people[people[:, 2] ** 2 + people[:, 3] ** 2 >= MIN_WALKING_SPEED * MIN_WALKING_SPEED]
    group = -(-num_beams // MAX_POINTS)
    for first in range(0, num_beams, group):
        nearest, beam = MAX_RANGE, -1
        for k in range(first, min(first + group, num_beams)):
            if 0.0 < ranges[k] < nearest:
                nearest, beam = float(ranges[k]), k
        if beam < 0:
            continue
        x, y = beam_end(nearest, beam, geometry)
        if not is_on_body(x, y, walking, BODY_MARGIN):
            points[0, count], points[1, count] = x, y
            count += 1
    return count


@njit(cache=True, error_model="numpy", fastmath=FAST)
def nearest(xs, ys, x, y):
    """Return the least squared distance of points from (x, y) [m2]."""
    least = np.float64(np.inf).view(np.int64)
    for j in range(xs.shape[0]):
        # Bits of positive floats are ordered like the floats, and LLVM vectorizes minima of integers only.
        least = min(least, np.float64((xs[j] - x) ** 2 + (ys[j] - y) ** 2).view(np.int64))
    return np.int64(least).view(np.float64)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def look_ahead(along, aside, x, y, sign, reach, length):
    """Return the path length of a disc until contact [m], and the least squared distance of points from its path [m2].

    The disc, of radius `reach`, drives from (x, y) along the first axis, or against it if `sign` is -1; the distance is
    from the first `length` [m] of the path. Points behind the disc are ignored. `along`, `aside`: points, shape (n,).
    """
    hit = least = np.float64(np.inf).view(np.int64)
    for j in range(along.shape[0]):
        ahead, squared = sign * (along[j] - x), (aside[j] - y) ** 2
        half, beyond = math.sqrt(max(reach * reach - squared, 0.0)), max(ahead - length, 0.0)
        until = max(ahead - half, 0.0) if (ahead > 0.0) & (half > 0.0) else np.inf
        hit = min(hit, np.float64(until).view(np.int64))
        least = min(least, np.float64(squared + beyond * beyond if ahead > 0.0 else np.inf).view(np.int64))
    return np.int64(hit).view(np.float64), np.int64(least).view(np.float64)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def roll_out(now, limits, speeds, turn, turned, xs, ys):
    """Predict positions while commands with one yaw rate are held; return the final heading [rad].

    `turn`: yaw rate / maximum. `turned`: scratch, shape (2, NUM_STEPS). `xs`, `ys`: positions by speed and step, shape
    (n, NUM_STEPS), base frame [m].
    """
    max_v, max_w, acc_v, acc_w, _, _ = limits
    w, theta = now[1], 0.0
    for step in range(NUM_STEPS):
        w += min(max(turn * max_w - w, -acc_w * STEP), acc_w * STEP)
        turned[0, step], turned[1, step] = math.cos(theta + 0.5 * w * STEP), math.sin(theta + 0.5 * w * STEP)
        theta += w * STEP
    for i in range(speeds.shape[0]):
        v, x, y = now[0], 0.0, 0.0
        for step in range(NUM_STEPS):
            v += min(max(speeds[i] * max_v - v, -acc_v * STEP), acc_v * STEP)
            x += v * STEP * turned[0, step]
            y += v * STEP * turned[1, step]
            xs[i, step], ys[i, step] = x, y
    return theta


@njit(cache=True, error_model="numpy", fastmath=FAST)
def hold(points, people, xs, ys, i, radius, reach):
    """Return the outcome of a command while it is held, at positions in row `i` of `xs` and `ys`.

    Returns:
        Least squared distance of points [m2], times to contact with walls and people [s], closeness to people.
    """
    least, until_wall, until_person, near_person = np.inf, HORIZON, HORIZON, 0.0
    for step in range(NUM_STEPS):
        x, y, time = xs[i, step], ys[i, step], (step + 1) * STEP
        squared = nearest(points[0], points[1], x, y)
        least = min(least, squared)
        until_wall = min(until_wall, time) if math.sqrt(squared) < reach else until_wall
        for k in range(people.shape[0]):
            person = people[k]
            dx, dy = person[0] + time * person[2] - x, person[1] + time * person[3] - y
            both = person[4] + radius
            squared = dx * dx + dy * dy
            if squared < (both + NEAR_PERSON) ** 2:
                gap = math.sqrt(squared) - both
                until_person = min(until_person, time) if gap < 0.0 else until_person
                near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * DECAYS[step])
    return least, until_wall, until_person, near_person


@njit(cache=True, error_model="numpy", fastmath=FAST)
def meet_people(people, x, y, velocity, radius, until_person, near_person):
    """Return time to contact [s] and closeness to people in the straight drive from (x, y), where `HOLD` ends.

    `velocity`: of the robot, base frame [m/s]. `until_person`, `near_person`: time and closeness up to now.
    """
    for k in range(people.shape[0]):
        person = people[k]
        dx, dy = person[0] + HOLD * person[2] - x, person[1] + HOLD * person[3] - y
        vx, vy, both = person[2] - velocity[0], person[3] - velocity[1], person[4] + radius
        squared, closing, distance = vx * vx + vy * vy, -(dx * vx + dy * vy), dx * dx + dy * dy
        far = both + NEAR_PERSON
        if squared < 1e-4 or closing <= 0.0 or (distance - far * far) * squared >= closing * closing:
            continue  # passes at a distance, as most people do
        time = min(closing / squared, HORIZON - HOLD)
        gap = math.hypot(dx + time * vx, dy + time * vy) - both
        closeness = min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-(HOLD + time) / DECAY_TIME)
        near_person = max(near_person, closeness)
        inside = closing * closing - squared * (distance - both * both)
        if inside > 0.0:
            time = (closing - math.sqrt(inside)) / squared
            until_person = min(until_person, HOLD + time) if time >= 0.0 else until_person
    return until_person, near_person


@njit(cache=True, error_model="numpy", fastmath=FAST)
def predict_outcomes(now, limits, points, people, twists, out):
    """Predict motions by velocity commands; write the features of `Trajectories` to `out`, shape (n * m, 8), float32.

    `now`: forward speed and yaw rate [m/s, rad/s]. `limits`: robot's maximum speeds, accelerations, footprint radius,
    and whether the lidar sees the rear. `points`: on walls, shape (2, k), base frame [m]. `people`: x, y, vx, vy,
    radius, shape (l, 5), base frame [m, m/s]. `twists`: n speeds and m yaw rates / maxima, in all combinations.
    """
    max_v, radius, sees_behind = limits[0], limits[4], limits[5]
    speeds, turns = twists
    points, num_points = points.copy(), points.shape[1]  # contiguous, for vector instructions
    reach = min(radius + WALL_MARGIN, math.sqrt(nearest(points[0], points[1], 0.0, 0.0)) - 0.25 * WALL_MARGIN)
    along, aside = np.empty(num_points + 1), np.empty(num_points + 1)
    xs, ys = np.empty((speeds.shape[0], NUM_STEPS)), np.empty((speeds.shape[0], NUM_STEPS))
    turned, farthest = np.empty((2, NUM_STEPS)), max_v * (HOLD + 0.5 * LINE_TIME)
    for turn in range(turns.shape[0]):
        theta, low, high, count = roll_out(now, limits, speeds, turns[turn], turned, xs, ys), np.inf, -np.inf, 0
        ux, uy = math.cos(theta), math.sin(theta)
        for i in range(speeds.shape[0]):
            offset = ys[i, NUM_STEPS - 1] * ux - xs[i, NUM_STEPS - 1] * uy
            low, high = min(low, offset), max(high, offset)
        # The points beside the straight lines that follow, which are parallel.
        low, high = low - reach - NEAR_WALL, high + reach + NEAR_WALL
        for j in range(num_points):
            along[count], aside[count] = points[0, j] * ux + points[1, j] * uy, points[1, j] * ux - points[0, j] * uy
            count += (low <= aside[count]) & (aside[count] <= high)
        for i in range(speeds.shape[0]):
            least, until_wall, until_person, near_person = hold(points, people, xs, ys, i, radius, reach)
            x, y, v = xs[i, NUM_STEPS - 1], ys[i, NUM_STEPS - 1], speeds[i] * max_v
            near_wall = max(0.0, 1.0 - (math.sqrt(least) - reach) / NEAR_WALL)
            if v < 0.0 and not sees_behind:
                until_wall, near_wall = 0.0, 1.0
            elif v != 0.0:
                place = x * ux + y * uy, y * ux - x * uy, math.copysign(1.0, v)
                hit, squared = look_ahead(along[:count], aside[:count], *place, reach, abs(v) * LINE_TIME)
                until_wall = min(until_wall, HOLD + hit / abs(v))
                near_wall = max(near_wall, 1.0 - (math.sqrt(squared) - reach) / NEAR_WALL)
            velocity = v * ux, v * uy
            until_person, near_person = meet_people(people, x, y, velocity, radius, until_person, near_person)
            row = out[i * turns.shape[0] + turn]
            row[0], row[1] = until_wall / HORIZON, until_person / HORIZON
            row[2], row[3] = min(near_wall, 1.0), near_person
            row[4], row[5] = (x + 0.5 * LINE_TIME * v * ux) / farthest, (y + 0.5 * LINE_TIME * v * uy) / farthest
            row[6] = theta / math.pi
            row[7] = min(max((math.sqrt(least) - radius) / SMALL_GAP, -1.0), 1.0)


@njit(cache=True, error_model="numpy")
def write_trajectories(rows, ranges, memory, active, geometry, limits, tracker, twists, out):
    """Update people trackers by the last scans; write the observation `Trajectories` to `out`, shape (n, m, 8).

    `memory`: arrays of the people trackers, one row per robot: state, tracks, past scans, lidar poses.
    """
    points, people = np.empty((2, MAX_POINTS)), np.empty((MAX_TRACKS, 5))
    clusters = np.empty((MAX_CLUSTERS, CLUSTER_SIZE))
    states, all_tracks, all_scans, all_poses = memory
    for i in range(active.shape[0]):
        if not active[i]:
            continue
        row, state, tracks = rows[i], states[i], all_tracks[i].reshape(MAX_TRACKS, TRACK_SIZE)
        if row.steps != state[STEPS]:
            kept = all_scans[i].reshape(-1, ranges.shape[1]), all_poses[i].reshape(-1, 4)
            motion = as_tuple(row.odometry, 3)
            track_people(ranges[i], geometry, motion, row.period, state, tracks, kept, clusters, tracker)
            state[STEPS] = row.steps
        found = people[: write_bodies(state, tracks, people)]
        count = find_walls(ranges[i], geometry, found, points)
        now = as_tuple(row.twist, 2)
        predict_outcomes(now, limits, points[:, :count], found, twists, out[i])


class Trajectories(RowPart):
    """Observation of predicted motions by velocity commands: `Box(-inf, inf, (66, 8), float32)`.

    A command is held for 0.5 s, with the robot's accelerations. Then the robot drives straight. The features are time
    to contact with a wall, and with a person at constant velocity, / 3 s (1 for no contact); closeness to walls (1 at
    the footprint, 0 from 0.4 m) and to people (0 from 0.8 m, decaying with time); position after 1 s, forward and left,
    / distance at maximum speed; heading change / pi; minimum gap to walls within 0.5 s / 0.1 m, from -1 to 1, negative
    for contact. Reversing without a view of the rear counts as contact.

    Person-sized clusters count as people from the second scan on, and as walls while standing. After the dynamic window
    approach (Fox, Burgard and Thrun, 1997).
    """

    def __init__(self, fine: bool = False) -> None:
        """Set whether slow commands for accurate stops are predicted as well: `Box(-inf, inf, (130, 8))`."""
        self._commands = (FINE_SPEEDS, FINE_TURNS) if fine else (SPEEDS, TURNS)

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, (math.prod(map(len, self._commands)), NUMBERS), np.float32)

    def reset(self, robot: Robot) -> None:
        params, lidar = robot.params, robot.params.lidar
        sees_behind = bool(lidar.directions[0].min() < -math.cos(REAR_ANGLE))
        limits = params.max_v, params.max_w, params.max_acc_v, params.max_acc_w, params.radius, sees_behind
        twists = tuple(np.array(values, np.float32) for values in self._commands)
        self._fixed = ScanGeometry.of(lidar), limits, tracker_numbers(lidar, SENSITIVE_TRACKER), twists
        num_scans = num_kept_scans(SENSITIVE_TRACKER)
        self._memory = [("trajectories", name) for name in ("state", "tracks", "scans", "poses")]
        sizes = STATE, MAX_TRACKS * TRACK_SIZE, num_scans * lidar.num_beams, num_scans * 4
        for key, size in zip(self._memory, sizes, strict=True):
            robot.remember(key, size, np.float32 if key[1] == "scans" else np.float64)[:] = 0.0
        robot.remember(self._memory[0], STATE)[STEPS] = -1.0

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        memory = tuple(rows.memory[key] for key in self._memory)
        write_trajectories(rows.numbers, rows.ranges, memory, rows.active, *self._fixed, out)
