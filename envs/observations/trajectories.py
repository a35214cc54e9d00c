"""Observation of the predicted motions by candidate velocity commands (twists)."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit

from lidarnaut.envs.estimation.scan_clusters import CLUSTER_SIZE
from lidarnaut.envs.estimation.tracking import (
    MAX_CLUSTERS,
    MAX_TRACKS,
    TRACK_SIZE,
    num_kept_scans,
    track_people,
    tracker_numbers,
    write_bodies,
)
from lidarnaut.envs.navigation.goal_navigator import SENSITIVE_TRACKER
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.task import RowPart

SPEEDS = -0.3, 0.0, 0.15, 0.3, 0.65, 1.0
"""Forward speeds of candidate velocity commands, fractions of the maximum."""
TURNS = -1.0, -0.65, -0.4, -0.225, -0.1, 0.0, 0.1, 0.225, 0.4, 0.65, 1.0
"""Yaw rates of candidate velocity commands, fractions of the maximum."""
TWISTS = np.array([(v, w) for v in SPEEDS for w in TURNS], dtype=np.float32)
"""Candidate velocity commands: fractions of maximum speed and yaw rate, shape (66, 2), float32."""
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
PERSON_MARGIN, MIN_WALKING_SPEED = 0.15, 0.5
WALL_MARGIN = 0.02
"""Safety margin around the footprint in predicted wall contacts [m]; smaller if the robot is already closer."""
REAR_ANGLE = 0.35
"""The lidar sees the rear if a beam is within this angle of the backward direction [rad]."""
STATE, STEPS = 9, 8


@njit(cache=True, error_model="numpy")
def find_walls(ranges, frame, people, points):
    """Write points on walls, seen by a scan, to `points`, shape (2, MAX_POINTS), base frame [m]; return their number.

    Each group of adjacent beams gives its nearest end point, unless on a walking person. `frame`: lidar x, y, and unit
    vectors of beams, shape (2, n), base frame. `people`: x, y, vx, vy, radius, shape (m, 5), base frame [m, m/s].
    """
    mount_x, mount_y, directions = frame
    num_beams, count = ranges.shape[0], 0
    group = -(-num_beams // MAX_POINTS)
    for first in range(0, num_beams, group):
        nearest, beam = MAX_RANGE, -1
        for k in range(first, min(first + group, num_beams)):
            if 0.0 < ranges[k] < nearest:
                nearest, beam = float(ranges[k]), k
        if beam < 0:
            continue
        x, y = mount_x + nearest * directions[0, beam], mount_y + nearest * directions[1, beam]
        is_wall = True
        for i in range(people.shape[0]):
            reach = people[i, 4] + PERSON_MARGIN
            walks = people[i, 2] ** 2 + people[i, 3] ** 2 >= MIN_WALKING_SPEED * MIN_WALKING_SPEED
            is_wall &= not walks or (x - people[i, 0]) ** 2 + (y - people[i, 1]) ** 2 >= reach * reach
        if is_wall:
            points[0, count], points[1, count] = x, y
            count += 1
    return count


@njit(cache=True, error_model="numpy", fastmath={"nnan", "nsz", "reassoc", "contract"})  # infinity is used
def predict_outcomes(now, limits, points, people, twists, out):
    """Predict motions by velocity commands; write the features of `Trajectories` to `out`, shape (n, 8), float32.

    `now`: forward speed and yaw rate [m/s, rad/s]. `limits`: robot's maximum speeds, accelerations, footprint radius,
    and whether the lidar sees the rear. `points`: on walls, shape (2, k), base frame [m]. `people`: x, y, vx, vy,
    radius, shape (m, 5), base frame [m, m/s]. `twists`: velocity commands / maximum speeds, shape (n, 2).
    """
    max_v, max_w, acc_v, acc_w, radius, sees_behind = limits
    here = np.inf
    for j in range(points.shape[1]):
        here = min(here, points[0, j] ** 2 + points[1, j] ** 2)
    reach = min(radius + WALL_MARGIN, math.sqrt(here) - 0.25 * WALL_MARGIN)
    for i in range(twists.shape[0]):
        v, w = now
        x = y = theta = near_wall = near_person = 0.0
        least = np.inf
        until_wall = until_person = HORIZON
        for step in range(int(HOLD / STEP)):
            v += min(max(twists[i, 0] * max_v - v, -acc_v * STEP), acc_v * STEP)
            w += min(max(twists[i, 1] * max_w - w, -acc_w * STEP), acc_w * STEP)
            x += v * STEP * math.cos(theta + 0.5 * w * STEP)
            y += v * STEP * math.sin(theta + 0.5 * w * STEP)
            theta += w * STEP
            time, squared = (step + 1) * STEP, np.inf
            for j in range(points.shape[1]):
                squared = min(squared, (points[0, j] - x) ** 2 + (points[1, j] - y) ** 2)
            least = min(least, squared)
            gap = math.sqrt(squared) - reach
            until_wall = min(until_wall, time) if gap < 0.0 else until_wall
            near_wall = max(near_wall, 1.0 - gap / NEAR_WALL)
            for k in range(people.shape[0]):
                dx, dy = people[k, 0] + time * people[k, 2] - x, people[k, 1] + time * people[k, 3] - y
                gap = math.hypot(dx, dy) - people[k, 4] - radius
                until_person = min(until_person, time) if gap < 0.0 else until_person
                near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-time / DECAY_TIME))
        v = twists[i, 0] * max_v
        if v < 0.0 and not sees_behind:
            until_wall, near_wall = 0.0, 1.0
        ux, uy, speed = math.cos(theta), math.sin(theta), abs(v)
        sign = 1.0 if v >= 0.0 else -1.0
        hit, squared = np.inf, np.inf
        for j in range(points.shape[1]):
            dx, dy = points[0, j] - x, points[1, j] - y
            along = sign * (dx * ux + dy * uy)
            aside = dx * dx + dy * dy - along * along
            if along > 0.0:
                if aside < reach * reach:
                    hit = min(hit, along - math.sqrt(reach * reach - aside))
                squared = min(squared, aside + max(along - speed * LINE_TIME, 0.0) ** 2)
        if speed > 0.0:
            until_wall = min(until_wall, HOLD + max(hit, 0.0) / speed)
            near_wall = max(near_wall, 1.0 - (math.sqrt(squared) - reach) / NEAR_WALL)
        for k in range(people.shape[0]):
            dx, dy = people[k, 0] + HOLD * people[k, 2] - x, people[k, 1] + HOLD * people[k, 3] - y
            vx, vy, both = people[k, 2] - v * ux, people[k, 3] - v * uy, people[k, 4] + radius
            squared, closing = vx * vx + vy * vy, -(dx * vx + dy * vy)
            if squared < 1e-4 or closing <= 0.0:
                continue
            time = min(closing / squared, HORIZON - HOLD)
            gap = math.hypot(dx + time * vx, dy + time * vy) - both
            near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-(HOLD + time) / DECAY_TIME))
            inside = closing * closing - squared * (dx * dx + dy * dy - both * both)
            if inside > 0.0:
                time = (closing - math.sqrt(inside)) / squared
                until_person = min(until_person, HOLD + time) if time >= 0.0 else until_person
        out[i, 0], out[i, 1] = until_wall / HORIZON, until_person / HORIZON
        out[i, 2], out[i, 3] = min(near_wall, 1.0), near_person
        farthest = max_v * (HOLD + 0.5 * LINE_TIME)
        out[i, 4], out[i, 5] = (x + 0.5 * LINE_TIME * v * ux) / farthest, (y + 0.5 * LINE_TIME * v * uy) / farthest
        out[i, 6] = theta / math.pi
        out[i, 7] = min(max((math.sqrt(least) - radius) / SMALL_GAP, -1.0), 1.0)


@njit(cache=True, error_model="numpy")
def write_trajectories(rows, ranges, memory, active, frame, limits, tracker, twists, out):
    """Update people trackers by the last scans; write the observation `Trajectories` to `out`, shape (n, 66, 8).

    `memory`: arrays of the people trackers, one row per robot: state, tracks, past scans, lidar poses.
    """
    points, people = np.empty((2, MAX_POINTS)), np.empty((MAX_TRACKS, 5))
    clusters = np.empty((MAX_CLUSTERS, CLUSTER_SIZE))
    states, all_tracks, all_scans, all_poses = memory
    for i in range(active.shape[0]):
        if not active[i]:
            continue
        row, state, tracks = rows[i], states[i], all_tracks[i].reshape(MAX_TRACKS, TRACK_SIZE)
        if row[at.STEPS] != state[STEPS]:
            kept = all_scans[i].reshape(-1, ranges.shape[1]), all_poses[i].reshape(-1, 4)
            motion = row[at.ODOMETRY], row[at.ODOMETRY + 1], row[at.ODOMETRY + 2]
            track_people(ranges[i], frame[2], motion, row[at.PERIOD], state, tracks, kept, clusters, tracker)
            state[STEPS] = row[at.STEPS]
        found = people[: write_bodies(state, tracks, tracker, people)]
        count = find_walls(ranges[i], frame, found, points)
        now = row[at.TWIST_V], row[at.TWIST_W]
        predict_outcomes(now, limits, points[:, :count], found, twists, out[i])


class Trajectories(RowPart):
    """Observation of predicted motions by 66 velocity commands: `Box(-inf, inf, (66, 8), float32)`.

    A command is held for 0.5 s, with the robot's accelerations. Then the robot drives straight. The features are time
    to contact with a wall, and with a person at constant velocity, / 3 s (1 for no contact); closeness to walls (1 at
    the footprint, 0 from 0.4 m) and to people (0 from 0.8 m, decaying with time); position after 1 s, forward and left,
    / distance at maximum speed; heading change / pi; minimum gap to walls within 0.5 s / 0.1 m, from -1 to 1, negative
    for contact. Reversing without a view of the rear counts as contact.

    Person-sized clusters count as people from the second scan on, and as walls while standing. After the dynamic window
    approach (Fox, Burgard and Thrun, 1997).
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, (len(TWISTS), NUMBERS), np.float32)

    def reset(self, robot: Robot) -> None:
        params, lidar, memory = robot.params, robot.params.lidar, robot._rows.remember
        sees_behind = bool(lidar.directions[0].min() < -math.cos(REAR_ANGLE))
        limits = params.max_v, params.max_w, params.max_acc_v, params.max_acc_w, params.radius, sees_behind
        frame = lidar.mount.x, lidar.mount.y, lidar.directions
        self._fixed = frame, limits, tracker_numbers(lidar, SENSITIVE_TRACKER), TWISTS
        num_scans = num_kept_scans(SENSITIVE_TRACKER)
        self._memory = [("trajectories", name) for name in ("state", "tracks", "scans", "poses")]
        sizes = STATE, MAX_TRACKS * TRACK_SIZE, num_scans * lidar.num_beams, num_scans * 4
        for key, size in zip(self._memory, sizes, strict=True):
            memory(key, size, np.float32 if key[1] == "scans" else np.float64)[robot.index] = 0.0
        memory(self._memory[0], STATE)[robot.index, STEPS] = -1.0

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        memory = tuple(batch.memory[key] for key in self._memory)
        write_trajectories(batch.numbers, batch.ranges, memory, batch.active, *self._fixed, out)
