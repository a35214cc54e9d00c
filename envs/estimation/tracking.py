"""People tracking in lidar scans by Kalman filters with constant velocity, in the odometry frame.

Clusters that are not known to be static start tracks. A track is confirmed as a person after significant motion.
"""

import math
from collections import namedtuple
from dataclasses import dataclass, fields
from operator import attrgetter

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.pose import compose
from lidarnaut.envs.geometry.rows import write_row
from lidarnaut.envs.robots import LidarParams

from .scan_clusters import (
    BODY,
    CLUSTER_SIZE,
    HIT,
    MAX_LEG_GAP,
    MIN_BEAMS,
    PASSED,
    SLOPE,
    find_clusters,
    join_legs,
    look_at_disc,
)
from .scan_points import ScanGeometry, are_on_bodies, scan_ends

MAX_CLUSTERS, MAX_TRACKS = 256, 128
X, Y, VX, VY, P_XX, P_XV, P_VV, RADIUS, HITS, MISSES, SEEN, BORN_X, BORN_Y, IS_PERSON, ID, ON_FREE = range(16)
"""Array indices of a track: Kalman filter in the odometry frame, then counters and flags. `SEEN`: time of the last
match [s]; `BORN_X`, `BORN_Y`: start position [m]; `ON_FREE`: number of matches in free space."""
TRACK_SIZE = 16
POSE, TIME, NUM_TRACKS, NUM_SCANS, NUM_BORN, NUM_CLUSTERS = 0, 3, 4, 5, 6, 7
"""Array indices of the tracker's state: odometry pose [m, m, rad], time [s], and counters. `NUM_SCANS`: number of scans
stored since the reset; `NUM_BORN`: number of tracks started since the reset."""


SCAN_INTERVAL = 1.0
"""Time between stored scans [s]."""
MARGIN, DRIFT = 0.1, 0.01
"""Range tolerance of free-space tests [m], and its increase per second of a stored scan's age, for odometry drift
[m/s]. A person's outline is free if beams end farther behind it than this."""
SPEED_STD = 0.8
"""Initial standard deviation of a track's velocity along an axis [m/s]."""
MAX_DEVIATION, MAX_GAP = 3.0, 0.8
"""Maximum distance between a track and a matched cluster: Mahalanobis distance, and distance [m]."""
MIN_SPEED = 0.2
"""Minimum speed of a track for confirmation as a person [m/s]."""
MAX_STD = 0.35
"""Maximum standard deviation of a reported person's position along an axis [m]."""
MAX_MISSES = 4
"""A track is deleted after this number of scans that show free space at its position."""
LOST_TIME = 3.0
"""Time after which an occluded person is deleted [s]. Unconfirmed tracks are deleted after a sixth of the time."""
MAX_UNSEEN_TIME = 0.35
"""Unconfirmed tracks are reported for this time after the last match [s]."""
MIN_BODY_RADIUS = 0.27
"""Minimum reported radius of a person [m]. A scan shows only one side."""


@dataclass(frozen=True, slots=True)
class TrackerParams:
    """Parameters of people tracking, tuned in simulations unless a source is given."""

    body_radius: float = 0.0
    """Radius assumed for a partly occluded body, to estimate the position of its centre [m]; 0 to disable."""
    memory: float = 16.0
    """Duration of the scan history [s]."""
    position_std: float = 0.08
    """Standard deviation of a cluster's measured position along an axis [m]."""
    acceleration: float = 0.6
    """Spectral density of people's white-noise acceleration [m2/s3] (Bar-Shalom et al., "Estimation with Applications
    to Tracking and Navigation", 2001, section 6.2.2)."""
    min_hits: int = 4
    """Minimum number of matched clusters to confirm a track as a person."""
    min_travel: float = 0.3
    """Minimum distance of a track from its start point for confirmation as a person [m]."""
    hidden_travel: float = math.inf
    """A track not seen in free space is confirmed only beyond this distance from its start point [m]; inf: never."""
    significance: float = 2.0
    """A track is confirmed only if its speed exceeds the speed's standard deviation by this factor."""
    stood_hits: int = 1
    """A body-sized cluster starts no track if this number of stored scans show an obstacle at its position."""
    static_hits: int = 12
    """A person-sized cluster is added to the map if this number of stored scans show an obstacle there, and none free
    space."""


SENSITIVE_TRACKER = TrackerParams(
    min_travel=0.25,
    hidden_travel=0.4,
    position_std=0.04,
    acceleration=1.5,
    memory=6.0,
    stood_hits=3,
    static_hits=4,
    body_radius=0.3,
)
"""Sensitive settings for local planning: a missed person is worse than a false positive."""
_OWN = tuple(field.name for field in fields(TrackerParams))
_OF_LIDAR = ("mount_x", "mount_y", "mount_yaw", "angle_min", "increment", "range_max", "is_full_turn")
TrackerNumbers = namedtuple("TrackerNumbers", [*_OF_LIDAR, *_OWN])  # type: ignore[misc]


def num_kept_scans(params: TrackerParams) -> int:
    """Return the number of scans that the tracker stores."""
    return max(1, math.ceil(params.memory / SCAN_INTERVAL))


def tracker_numbers(lidar: LidarParams, params: TrackerParams) -> TrackerNumbers:
    """Return lidar and tracker parameters as floats, for compiled functions."""
    mount, is_full_turn = lidar.mount, lidar.fov > 2.0 * math.pi - 1e-6
    beams = lidar.angle_min, lidar.angle_increment, lidar.range_max, is_full_turn
    return TrackerNumbers._make(map(float, (mount.x, mount.y, mount.yaw, *beams, *attrgetter(*_OWN)(params))))


@njit(cache=True, error_model="numpy")
def predict(track, dt, p):
    """Predict a track's position, velocity and covariance `dt` [s] ahead, in place."""
    q = p.acceleration
    track[X] += dt * track[VX]
    track[Y] += dt * track[VY]
    track[P_XX] += dt * (2.0 * track[P_XV] + dt * track[P_VV]) + q * dt**3 / 3.0
    track[P_XV] += dt * track[P_VV] + q * dt**2 / 2.0
    track[P_VV] += q * dt


@njit(cache=True, error_model="numpy")
def correct(track, x, y, p):
    """Correct a track with a measured position (x, y) [m] by a Kalman filter, in place."""
    s = track[P_XX] + p.position_std**2
    k_x, k_v = track[P_XX] / s, track[P_XV] / s
    dx, dy = x - track[X], y - track[Y]
    track[X] += k_x * dx
    track[Y] += k_x * dy
    track[VX] += k_v * dx
    track[VY] += k_v * dy
    track[P_VV] -= k_v * track[P_XV]
    track[P_XV] *= 1.0 - k_x
    track[P_XX] *= 1.0 - k_x


@njit(cache=True, error_model="numpy")
def _votes(x, y, radius, time, scans, poses, num_scans, p):
    passed = hits = 0
    for k in range(min(num_scans, scans.shape[0])):
        if 0.9 * SCAN_INTERVAL < time - poses[k, 3] <= p.memory:
            margin = MARGIN + DRIFT * (time - poses[k, 3])
            seen = look_at_disc(scans[k], poses[k], x, y, radius, margin, p)
            passed += seen == PASSED
            hits += seen == HIT
    return passed, hits


@njit(cache=True, error_model="numpy")
def _match(tracks, num_tracks, clusters, count, moved, matches, p):
    pairs, distances, num_pairs = np.empty((MAX_CLUSTERS, 2), dtype=np.int64), np.empty(MAX_CLUSTERS), 0
    for i in range(num_tracks):
        track = tracks[i]
        matches[i] = -1
        s = track[P_XX] + p.position_std**2
        reach = min(MAX_DEVIATION * MAX_DEVIATION * s, MAX_GAP * MAX_GAP)
        is_fast = math.hypot(track[VX], track[VY]) > 2.0 * MIN_SPEED
        for k in range(count):
            squared = (clusters[k, 0] - track[X]) ** 2 + (clusters[k, 1] - track[Y]) ** 2
            is_wall = (clusters[k, 4] == SLOPE and track[IS_PERSON] == 0.0) or (moved[k] < 0 and is_fast)
            if squared < reach and num_pairs < MAX_CLUSTERS and not is_wall:
                pairs[num_pairs, 0], pairs[num_pairs, 1] = i, k
                distances[num_pairs] = squared / s - (0.1 if track[IS_PERSON] > 0.0 else 0.0)
                num_pairs += 1
    is_taken = np.zeros(count, dtype=np.bool_)
    for _ in range(num_pairs):
        n = np.argmin(distances[:num_pairs])
        distances[n] = np.inf
        i, k = pairs[n, 0], pairs[n, 1]
        if matches[i] < 0 and not is_taken[k]:
            matches[i] = k
            is_taken[k] = True
    return is_taken


@njit(cache=True, error_model="numpy")
def _is_doubled(i, tracks, num_tracks, matches):
    for k in range(num_tracks):
        if matches[k] >= 0 and math.hypot(tracks[k, X] - tracks[i, X], tracks[k, Y] - tracks[i, Y]) < 0.7 * MAX_LEG_GAP:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _judge(track, ranges, lidar, p):
    if track[HITS] < p.min_hits:
        return False
    born = look_at_disc(ranges, lidar, track[BORN_X], track[BORN_Y], track[RADIUS], MARGIN, p)
    speed = math.hypot(track[VX], track[VY])
    travel = math.hypot(track[X] - track[BORN_X], track[Y] - track[BORN_Y])
    if track[ON_FREE] < p.min_hits and born != PASSED and travel < p.hidden_travel:
        return False
    return travel >= p.min_travel and speed >= max(MIN_SPEED, p.significance * math.sqrt(track[P_VV]))


@njit(cache=True, error_model="numpy")
def _start_tracks(state, tracks, clusters, is_taken, moved, p):
    num_tracks = int(state[NUM_TRACKS])
    for k in range(clusters.shape[0]):
        is_person = clusters[k, 4] != SLOPE and clusters[k, 3] >= MIN_BEAMS
        if is_taken[k] or moved[k] < 0 or not is_person or num_tracks == MAX_TRACKS:
            continue
        is_known = False
        for i in range(num_tracks):
            gap = math.hypot(tracks[i, X] - clusters[k, 0], tracks[i, Y] - clusters[k, 1])
            is_known |= gap < max(tracks[i, RADIUS] + clusters[k, 2], 0.7 * MAX_LEG_GAP)
        if not is_known:
            place = clusters[k, 0], clusters[k, 1]
            spread = p.position_std**2, 0.0, SPEED_STD**2
            first = (clusters[k, 2], 1.0, 0.0, state[TIME], *place, 0.0, state[NUM_BORN], 1.0 * (moved[k] == 1))
            write_row(tracks[num_tracks], (*place, 0.0, 0.0, *spread, *first))
            state[NUM_BORN] += 1.0
            num_tracks += 1
    state[NUM_TRACKS] = num_tracks


@njit(cache=True, error_model="numpy")
def track_people(ranges, geometry, motion, period, state, tracks, memory, clusters, p):
    """Update all tracks of people with a lidar scan, in place.

    `motion`: base pose relative to the last scan, by odometry; `period`: time since the last scan [s]; `memory`: past
    scans, shape (n, num_beams), float32 [m], and their lidar poses (x, y, theta, time), shape (n, 4).
    """
    scans, poses = memory
    x, y, theta = compose(state[0], state[1], state[2], motion[0], motion[1], motion[2])
    state[0], state[1], state[2], state[TIME] = x, y, theta, state[TIME] + period
    time, num_tracks, num_scans = state[TIME], int(state[NUM_TRACKS]), int(state[NUM_SCANS])
    lidar = compose(x, y, theta, p.mount_x, p.mount_y, p.mount_yaw)
    count = join_legs(clusters, find_clusters(ranges, geometry, p, clusters))
    state[NUM_CLUSTERS] = count
    c, s = math.cos(theta), math.sin(theta)
    moved = np.zeros(count, dtype=np.int64)
    for k in range(count):
        u, v = clusters[k, 0], clusters[k, 1]
        clusters[k, 0], clusters[k, 1] = x + c * u - s * v, y + s * u + c * v
        passed, hits = _votes(clusters[k, 0], clusters[k, 1], clusters[k, 2], time, scans, poses, num_scans, p)
        clusters[k, 5] = passed == 0 and hits >= p.static_hits
        has_stood = hits > 2 * passed and (hits >= p.stood_hits or clusters[k, 4] != BODY)
        moved[k] = 1 if passed > hits else (-1 if has_stood else 0)
    for i in range(num_tracks):
        predict(tracks[i], period, p)
    matches = np.empty(num_tracks, dtype=np.int64)
    is_taken = _match(tracks, num_tracks, clusters, count, moved, matches, p)
    kept = 0
    for i in range(num_tracks):
        track, k = tracks[i], matches[i]
        if k >= 0:
            correct(track, clusters[k, 0], clusters[k, 1], p)
            track[RADIUS] += 0.2 * (clusters[k, 2] - track[RADIUS])
            track[HITS] += 1.0
            track[ON_FREE] += moved[k] == 1
            track[MISSES], track[SEEN] = 0.0, time
            if track[IS_PERSON] == 0.0 and _judge(track, ranges, lidar, p):
                track[IS_PERSON] = 1.0
        else:
            is_gone = look_at_disc(ranges, lidar, track[X], track[Y], track[RADIUS], MARGIN, p) == PASSED
            track[MISSES] += is_gone or _is_doubled(i, tracks, num_tracks, matches)
        patience = LOST_TIME if track[IS_PERSON] > 0.0 else LOST_TIME / 6.0
        if track[MISSES] < MAX_MISSES and time - track[SEEN] <= patience + 1e-9:
            write_row(tracks[kept], track)
            kept += 1
    state[NUM_TRACKS] = kept
    _start_tracks(state, tracks, clusters[:count], is_taken, moved, p)
    if num_scans == 0 or time - poses[(num_scans - 1) % len(poses), 3] >= SCAN_INTERVAL - 1e-9:
        write_row(scans[num_scans % len(poses)], ranges)
        write_row(poses[num_scans % len(poses)], (*lidar, time))
        state[NUM_SCANS] += 1.0


@njit(cache=True, error_model="numpy")
def write_bodies(state, tracks, bodies):
    """Write confirmed and possible people (recently matched tracks) to `bodies`; return their number.

    `bodies`: x, y [m], velocity (x, y) [m/s], radius [m], base frame.
    """
    count = 0
    c, s = math.cos(state[2]), math.sin(state[2])
    for i in range(int(state[NUM_TRACKS])):
        track = tracks[i]
        is_seen = track[HITS] >= 2.0 and state[TIME] - track[SEEN] <= MAX_UNSEEN_TIME
        if is_seen or (track[IS_PERSON] > 0.0 and track[P_XX] <= MAX_STD**2):
            dx, dy, vx, vy = track[X] - state[0], track[Y] - state[1], track[VX], track[VY]
            place, velocity = (c * dx + s * dy, c * dy - s * dx), (c * vx + s * vy, c * vy - s * vx)
            write_row(bodies[count], (*place, *velocity, max(track[RADIUS], MIN_BODY_RADIUS)))
            count += 1
    return count


class PeopleTracker:
    """Tracker of people around one robot, from lidar scans and odometry."""

    def __init__(self, lidar: LidarParams, period: float, params: TrackerParams = TrackerParams()) -> None:
        """Create a tracker; `period` is the time between scans [s]."""
        self.params, self._period = params, period
        self._numbers, self._geometry = tracker_numbers(lidar, params), ScanGeometry.of(lidar)
        num_scans = num_kept_scans(params)
        self._memory = np.empty((num_scans, lidar.num_beams), dtype=np.float32), np.zeros((num_scans, 4))
        self._state, self._tracks = np.zeros(8), np.zeros((MAX_TRACKS, TRACK_SIZE))
        self._clusters = np.empty((MAX_CLUSTERS, CLUSTER_SIZE))

    def reset(self) -> None:
        self._state[:] = 0.0

    def update(self, ranges: np.ndarray, motion: Pose2D) -> np.ndarray:
        """Process a scan, shape (num_beams,), float32 [m]; return the confirmed people.

        `motion`: base pose relative to the last scan, by odometry.
        """
        arrays = self._state, self._tracks, self._memory, self._clusters
        track_people(ranges, self._geometry, tuple(motion), self._period, *arrays, self._numbers)
        return self.people

    @property
    def people(self) -> np.ndarray:
        """Confirmed people as x, y [m], ground velocity (x, y) [m/s], radius [m]: shape (n, 5), float64, base frame."""
        tracks = self.tracks
        tracks = tracks[(tracks[:, IS_PERSON] > 0.0) & (tracks[:, P_XX] <= MAX_STD**2)]
        pose = Pose2D(*self._state[POSE : POSE + 3].tolist())
        turned = Pose2D(0.0, 0.0, -pose.theta).transform(tracks[:, VX : VY + 1])
        return np.column_stack([pose.inverse().transform(tracks[:, : Y + 1]), turned, tracks[:, RADIUS]])

    @property
    def bodies(self) -> np.ndarray:
        """Confirmed and possible people (recently matched tracks): shape (n, 5), float64, columns as in `people`."""
        bodies = np.empty((MAX_TRACKS, 5))
        return bodies[: write_bodies(self._state, self._tracks, bodies)]

    @property
    def tracks(self) -> np.ndarray:
        """All tracks, a view of shape (n, TRACK_SIZE), float64: one row per track, column indices `X` to `ON_FREE`."""
        return self._tracks[: int(self._state[NUM_TRACKS])]

    def is_on_person(self, ranges: np.ndarray, *, standing: bool) -> np.ndarray:
        """Return the mask of beams that end within 0.1 m of people or person-sized clusters: shape (num_beams,), bool.

        `standing`: whether clusters count that are known to be static.
        """
        clusters = self._clusters[: int(self._state[NUM_CLUSTERS])]
        is_body = (clusters[:, 4] != SLOPE) & (clusters[:, 3] >= MIN_BEAMS)
        clusters = clusters[is_body & ((clusters[:, 5] == 0.0) | standing)]
        pose = Pose2D(*self._state[POSE : POSE + 3].tolist()).inverse()
        bodies = np.zeros((len(clusters), 5))
        bodies[:, :2], bodies[:, 4] = pose.transform(clusters[:, :2]), clusters[:, 2]
        return are_on_bodies(scan_ends(ranges, self._geometry), np.vstack([self.people, bodies]), 0.1)
