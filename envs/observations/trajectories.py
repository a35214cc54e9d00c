"""What driving by each of a table of twists would lead to, among walls and people."""

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
"""Forward speeds of the table over the robot's limit."""
TURNS = -1.0, -0.65, -0.4, -0.225, -0.1, 0.0, 0.1, 0.225, 0.4, 0.65, 1.0
"""Yaw rates of the table over the robot's limit."""
TWISTS = np.array([(v, w) for v in SPEEDS for w in TURNS], dtype=np.float32)
"""The table, shape (66, 2), as actions are."""
NUMBERS, END, TURN = 8, slice(4, 6), 6
"""How many numbers are shown of each twist, and which of them say where it ends and how far it turns."""
HOLD, STEP, HORIZON = 0.5, 0.125, 3.0
"""Time for which a twist is held before the robot drives straight on, between two poses of that time at which contact
is looked for, and how far ahead is looked [s]."""
ALONG = 1.0
"""Time on the straight line in which nearness to walls counts, half of which leads to the end that is shown [s]."""
NEAR_WALL, NEAR_PERSON, FADE = 0.4, 0.8, 1.5
"""Gaps to walls and people from which on these are not near [m]; time in which that to people falls to 1 / e [s]."""
SMALL_GAP = 0.1
"""Gaps of narrow passages are shown over this [m]."""
MAX_POINTS, MAX_RANGE = 120, 6.0
"""Most points of a scan that are looked at, each the nearest of neighbouring beams, and how far away [m]."""
ON_PERSON, WALKING = 0.15, 0.5
"""Points this near to a person's edge are the person's [m], if the person is this fast [m/s]: what stands may be a
pillar, of which the points say better where it is."""
MARGIN = 0.02
"""Distance from points that is kept [m], but for what is nearer already."""
BEHIND = 0.35
"""A lidar of which a beam points backwards within this angle sees what is behind [rad]."""
STATE, STEPS = 9, 8
"""Size of the state of the tracker, and its last entry: the control period of the last update."""


@njit(cache=True, error_model="numpy")
def find_walls(ranges, frame, people, points):
    """Write the nearest points of neighbouring beams that lie on nobody who walks, base frame [m]; returns how many.

    `frame`: x, y of the lidar, and unit vectors along its beams, shape (2, n), base frame [m]; `people`: see
    `look_ahead`; `points`: shape (2, MAX_POINTS), written.
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
            reach = people[i, 4] + ON_PERSON
            walks = people[i, 2] ** 2 + people[i, 3] ** 2 >= WALKING * WALKING
            is_wall &= not walks or (x - people[i, 0]) ** 2 + (y - people[i, 1]) ** 2 >= reach * reach
        if is_wall:
            points[0, count], points[1, count] = x, y
            count += 1
    return count


@njit(cache=True, error_model="numpy", fastmath={"nnan", "nsz", "reassoc", "contract"})  # infinity is used
def look_ahead(now, limits, points, people, twists, out):
    """Write what each twist leads to, shape (n, NUMBERS), float32; see `Trajectories`.

    `now`: forward speed and yaw rate [m/s, rad/s]; `limits`: greatest ones, greatest accelerations, radius of the
    footprint, and whether the lidar sees what is behind; `points`: shape (2, k), walls, base frame [m]; `people`: shape
    (m, 5), as `PeopleTracker.people`.
    """
    max_v, max_w, acc_v, acc_w, radius, sees_behind = limits
    here = np.inf
    for j in range(points.shape[1]):
        here = min(here, points[0, j] ** 2 + points[1, j] ** 2)
    reach = min(radius + MARGIN, math.sqrt(here) - 0.25 * MARGIN)
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
                near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-time / FADE))
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
                squared = min(squared, aside + max(along - speed * ALONG, 0.0) ** 2)
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
            near_person = max(near_person, min(1.0, 1.0 - gap / NEAR_PERSON) * math.exp(-(HOLD + time) / FADE))
            inside = closing * closing - squared * (dx * dx + dy * dy - both * both)
            if inside > 0.0:
                time = (closing - math.sqrt(inside)) / squared
                until_person = min(until_person, HOLD + time) if time >= 0.0 else until_person
        out[i, 0], out[i, 1] = until_wall / HORIZON, until_person / HORIZON
        out[i, 2], out[i, 3] = min(near_wall, 1.0), near_person
        farthest = max_v * (HOLD + 0.5 * ALONG)
        out[i, 4], out[i, 5] = (x + 0.5 * ALONG * v * ux) / farthest, (y + 0.5 * ALONG * v * uy) / farthest
        out[i, 6] = theta / math.pi
        out[i, 7] = min(max((math.sqrt(least) - radius) / SMALL_GAP, -1.0), 1.0)


@njit(cache=True, error_model="numpy")
def write_trajectories(rows, ranges, memory, active, frame, limits, tracker, twists, out):
    """Track people for active rows, once in a control period, and write what twists lead to: shape (n, ...), float32.

    `memory`: state, tracks, scans, and poses of scans of each row, see `track_people`; `frame`: see `find_walls`;
    `limits`: see `look_ahead`.
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
        look_ahead(now, limits, points[:, :count], found, twists, out[i])


class Trajectories(RowPart):
    """What each of 66 twists would lead to: eight numbers for each, by the last scan, and by people tracked in scans.

    A twist, one of six forward speeds and eleven yaw rates (`TWISTS`), is approached with the robot's accelerations
    and held for 0.5 s; then the robot drives straight on. Shown are the times until it touches a wall, and a person
    who walks on as now, over 3 s, 1 for no contact until then; nearness to walls (1 at the footprint, 0 from 0.4 m on),
    and to people (from 0.8 m on; less the later); where it is after 1 s, forward and to the left, over what it drives
    in 1 s at its greatest speed; how far it has turned, over pi; and the least gap to walls within the 0.5 s over
    0.1 m, negative for contact, from -1 to 1, since passages may leave a few centimetres. Backwards, where the lidar
    does not see, counts as contact with a wall.

    People are tracked as controllers do (`goal_navigator.SENSITIVE_TRACKER`). Whatever is as large as a
    person counts as one, with the velocity that scans show, from its second scan on; while it stands, it is a wall as
    well. After the dynamic window approach (Fox, Burgard and Thrun, 1997), whose objective a policy learns in place of
    adding it up.
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-inf, inf, (66, 8), float32)`."""
        return spaces.Box(-np.inf, np.inf, (len(TWISTS), NUMBERS), np.float32)

    def reset(self, robot: Robot) -> None:
        """Begin an episode: forget all people."""
        params, lidar, memory = robot.params, robot.params.lidar, robot._rows.remember
        sees_behind = bool(lidar.directions[0].min() < -math.cos(BEHIND))
        limits = params.max_v, params.max_w, params.max_acc_v, params.max_acc_w, params.radius, sees_behind
        self._fixed = (
            (lidar.mount.x, lidar.mount.y, lidar.directions),
            limits,
            tracker_numbers(lidar, SENSITIVE_TRACKER),
            TWISTS,
        )
        num_scans = num_kept_scans(SENSITIVE_TRACKER)
        self._memory = [("trajectories", name) for name in ("state", "tracks", "scans", "poses")]
        sizes = STATE, MAX_TRACKS * TRACK_SIZE, num_scans * lidar.num_beams, num_scans * 4
        for key, size in zip(self._memory, sizes, strict=True):
            memory(key, size, np.float32 if key[1] == "scans" else np.float64)[robot.index] = 0.0
        memory(self._memory[0], STATE)[robot.index, STEPS] = -1.0

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        """Write the outcomes of the twists of many robots; see `RowPart`."""
        memory = tuple(batch.memory[key] for key in self._memory)
        write_trajectories(batch.numbers, batch.ranges, memory, batch.active, *self._fixed, out)
