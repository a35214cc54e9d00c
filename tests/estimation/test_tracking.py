import copy
import math

import numpy as np
import pytest

from lidarnaut.envs.estimation import tracking as at
from lidarnaut.envs.estimation.scan_points import ScanGeometry, are_on_bodies, scan_ends
from lidarnaut.envs.estimation.tracking import SENSITIVE_TRACKER, PeopleTracker, TrackerParams
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams, Mount
from tests.slam.rooms import rectangle
from tests.slam.rooms import scan as exact_scan

LIDAR = LidarParams(num_beams=360, range_max=12.0, range_min=0.12, noise_std=0.01, mount=Mount(x=-0.05, yaw=0.3))
SIDE = 12.0
BLOCKS = [(8.0, 3.0, 0.5), (2.0, 9.0, 0.4), (5.0, 6.0, 1.5)]
PILLARS = [(3.0, 3.0, 0.25), (9.0, 8.0, 0.15), (6.0, 10.0, 0.05)]


SEGMENTS = np.concatenate([rectangle(0, 0, SIDE, SIDE), *(rectangle(x, y, x + s, y + s) for x, y, s in BLOCKS)])


def scan(pose, circles, rng, lidar=LIDAR):
    return exact_scan(pose, rng, lidar.noise_std, SEGMENTS, lidar, np.array([*PILLARS, *circles], dtype=float))


def ends_of(pose, ranges):
    """Return endpoints of beams, shape (num_beams, 2), world frame [m]."""
    ranges = np.nan_to_num(ranges, posinf=1e3)
    return pose.transform((ranges * LIDAR.directions).T + (LIDAR.mount.x, LIDAR.mount.y))


def gaps_between(points, others):
    """Return distances of the first two columns, shape (len(points), len(others)) [m]."""
    return np.hypot(*np.moveaxis(points[:, None, :2] - others[:, :2], 2, 0))


def body(kind, x, y, vx, vy, time):
    """Return the circles of a person: a disc, or swinging legs."""
    if kind == "disc":
        return [(x, y, 0.25)]
    speed = math.hypot(vx, vy)
    ahead = np.array([vx, vy]) / speed
    swing = 0.3 * speed * math.sin(2.0 * math.pi * time * speed / 1.4)
    sides = 0.1 * np.array([-ahead[1], ahead[0]]) + swing * ahead
    return [(x + sides[0], y + sides[1], 0.06), (x - sides[0], y - sides[1], 0.06)]


def course(time):
    """Return the pose on a figure of eight around the block at 1 m/s, with fast turns."""
    angle = time / 3.0
    return Pose2D(6.0 + 3.5 * math.sin(angle), 4.0 + 2.5 * math.sin(2.0 * angle), 2.0 * math.sin(0.9 * time))


def drive(tracker, people, seconds, rng, kind="disc", lidar=LIDAR, course=course):
    """Yield time, pose, tracker output and true people for each scan; `people`: functions of the time."""
    before = course(-0.1)
    for k in range(int(seconds * 10)):
        time = 0.1 * k
        pose, rows = course(time), np.array([person(time) for person in people]).reshape(-1, 4)
        circles = [circle for row in rows for circle in body(kind, *row, time)]
        motion = before.between(pose)
        noisy = Pose2D(motion.x * rng.normal(1.0, 0.02), motion.y, motion.theta * rng.normal(1.0, 0.01))
        ranges, before = scan(pose, circles, rng, lidar), pose
        yield time, pose, tracker.update(ranges, noisy), rows, ranges


def walks(number, rng):
    """Return people that walk straight, back and forth, at 0.5 to 1.3 m/s."""

    def walk(start, end, speed, time):
        length = math.dist(start, end)
        phase = (time * speed / length + 0.3 * start[0]) % 2.0
        sign = 1.0 if phase < 1.0 else -1.0
        share = phase if phase < 1.0 else 2.0 - phase
        along = (np.array(end) - start) / length
        return *(start + share * length * along), *(sign * speed * along)

    ends, speeds = rng.uniform(0.7, SIDE - 0.7, (number, 2, 2)), rng.uniform(0.5, 1.3, number)
    return [lambda time, e=e, s=s: walk(np.array(e[0]), np.array(e[1]), s, time) for e, s in zip(ends, speeds)]


@pytest.mark.parametrize("kind", ["disc", "legs"])
def test_people_are_found_with_their_velocities(kind):
    rng, visible, wrong, errors = np.random.default_rng(1), 0, 0, []
    for time, pose, tracks, people, ranges in drive(PeopleTracker(LIDAR, 0.1), walks(6, rng), 40.0, rng, kind):
        if time < 4.0:
            continue
        seen = (gaps_between(ends_of(pose, ranges), people) < 0.4).sum(axis=0) > 3
        seen &= np.hypot(*(people[:, :2] - pose[:2]).T) < 7.0
        gaps = gaps_between(pose.transform(tracks[:, :2]), people)
        visible += seen.sum()
        wrong += (gaps.min(axis=1, initial=9.0) > 0.6).sum()
        for k in np.flatnonzero(seen & (gaps.min(axis=0, initial=9.0) < 0.5)):
            velocity = Pose2D(0.0, 0.0, pose.theta).transform(tracks[gaps[:, k].argmin(), None, 2:4])[0]
            errors.append(np.hypot(*(velocity - people[k, 2:])))
    assert visible > 300
    assert len(errors) > 0.85 * visible
    assert wrong < 0.1 * visible
    assert np.median(errors) < 0.2
    assert 0.05 < np.median(tracks[:, 4]) < 0.4


@pytest.mark.parametrize("lidar", [LIDAR, LidarParams(270, 5.0, fov=math.radians(270.0), noise_std=0.01)])
def test_walls_and_pillars_are_no_people_for_a_robot_that_turns_fast(lidar):
    for _, _, tracks, _, _ in drive(PeopleTracker(lidar, 0.1), [], 60.0, np.random.default_rng(2), lidar=lidar):
        assert len(tracks) == 0


def stand(time):
    return Pose2D(6.0, 2.0, 1.0)


def test_who_stands_becomes_a_person_by_walking_and_stays_one_standing():
    def person(time):
        return 3.0 + min(max(time - 5.0, 0.0), 3.0), 4.5, (1.0 if 5.0 < time < 8.0 else 1e-9), 0.0

    for time, _, tracks, _, _ in drive(
        PeopleTracker(LIDAR, 0.1), [person], 20.0, np.random.default_rng(3), course=stand
    ):
        assert len(tracks) == 0 or time > 4.95
        assert len(tracks) == 1 or time < 6.55


@pytest.mark.parametrize(("hidden_travel", "shown"), [(math.inf, [0, 0, 0]), (0.2, [1, 1, 1])])
def test_who_comes_straight_from_where_no_scan_has_looked_past_is_a_person_after_hidden_travel(hidden_travel, shown):
    params = TrackerParams(min_hits=2, min_travel=0.1, significance=1.0, hidden_travel=hidden_travel)
    tracker, rng = PeopleTracker(LIDAR, 0.1, params), np.random.default_rng(8)
    steps = drive(tracker, [lambda t: (3.0 + t, 4.5 - 0.833 * t, 1.0, -0.833)], 0.8, rng, course=stand)
    assert [len(tracks) for _, _, tracks, _, _ in steps][-3:] == shown


def test_who_is_hidden_is_kept_for_a_while():
    tracker, hidden = PeopleTracker(LIDAR, 0.1), []

    def person(time):  # behind the block from x = 4.0 on; it stays there
        return min(1.0 + time, 5.7), 8.2, 1.0, 0.0

    for _, _, tracks, _, _ in drive(tracker, [person], 12.0, np.random.default_rng(4), course=stand):
        hidden.append((len(tracks), int(tracker.tracks[:, at.IS_PERSON].sum())))
    assert (1, 1) in hidden[20:40]
    assert (0, 1) in hidden
    assert hidden[-1] == (0, 0)


def test_who_has_gone_is_not_kept():
    def walking(time):
        return (3.0 + time, 4.5, 1.0, 0.0) if time < 3.0 else (-50.0, -50.0, 1.0, 0.0)

    steps = drive(PeopleTracker(LIDAR, 0.1), [walking], 4.0, np.random.default_rng(4), course=stand)
    shown = [len(tracks) for _, _, tracks, _, _ in steps]
    assert (shown[28], shown[36]) == (1, 0)


def test_what_is_as_large_as_a_person_is_a_body_from_its_second_scan_on():
    tracker, rng, walker = PeopleTracker(LIDAR, 0.1), np.random.default_rng(8), lambda t: (9.5, 4.0 + 1.2 * t, 0.0, 1.2)
    for time, pose, people, rows, _ in drive(tracker, [walker], 0.8, rng, course=lambda _: Pose2D(8.0, 5.5, 0.0)):
        is_there = gaps_between(pose.transform(tracker.bodies[:, :2]), rows)[:, 0] < 0.2
        assert is_there.sum() == (time > 0.05)
        if len(people) == 0 and time > 0.25:
            np.testing.assert_allclose(tracker.bodies[is_there][0, 2:4], (0.0, 1.2), atol=0.6)
    assert len(people) == 1
    assert len(tracker.bodies) >= 1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_centre_of_what_is_hidden_in_part_is_that_of_the_whole_body(side):
    pose, person, rng = Pose2D(3.0, 6.0, 0.2), (6.0, 4.5, 0.3), np.random.default_rng(4)
    away = np.array(person[:2]) - pose[:2]
    beside = side * np.array([-away[1], away[0]]) / np.hypot(*away)
    errors = {}
    for radius in (0.0, 0.3):
        tracker = PeopleTracker(LIDAR, 0.1, TrackerParams(body_radius=radius))
        for _ in range(2):
            before = pose[:2] + 0.5 * away + 0.33 * beside
            tracker.update(scan(pose, [person, (*before, 0.3)], rng), Pose2D(0.0, 0.0, 0.0))
        centres = pose.transform(tracker.bodies[:, :2])
        errors[radius] = np.hypot(*(centres - person[:2]).T).min()
    assert errors[0.3] < 0.05 < errors[0.0]


def test_beams_on_people_are_told_from_beams_on_walls():
    rng, tracker = np.random.default_rng(5), PeopleTracker(LIDAR, 0.1)
    right = wrong = beams = 0
    for time, pose, _, people, ranges in drive(tracker, walks(3, rng), 20.0, rng):
        truth = (gaps_between(ends_of(pose, ranges), people) < 0.3).any(axis=1) & (ranges < 7.0)
        mask = are_on_bodies(scan_ends(ranges, ScanGeometry.of(LIDAR)), tracker.people, 0.1)
        moving, all_bodies = (tracker.is_on_person(ranges, standing=standing) for standing in (False, True))
        assert not (mask & ~moving).any()
        assert not (moving & ~all_bodies).any()
        if time > 4.0:
            right, wrong, beams = right + (mask & truth).sum(), wrong + (mask & ~truth).sum(), beams + truth.sum()
    assert right > 0.85 * beams
    assert wrong < 0.1 * beams


def test_a_piece_of_wall_between_bodies_is_no_body():
    pose, pillars = Pose2D(6.0, 1.8, -math.pi / 2.0), [(5.57, 0.8, 0.25), (6.43, 0.8, 0.25)]
    tracker, rng = PeopleTracker(LIDAR, 0.1), np.random.default_rng(8)
    for _ in range(3):
        tracker.update(scan(pose, pillars, rng), Pose2D(0.0, 0.0, 0.0))
        places = pose.transform(tracker.bodies[:, :2])
    assert (np.hypot(*(places - (6.0, 0.0)).T) > 0.5).all()
    assert all(np.hypot(*(places - pillar[:2]).T).min() < 0.1 for pillar in pillars)


def test_somebody_who_follows_another_is_lost_nowhere():
    rng, tracker, missed = np.random.default_rng(9), PeopleTracker(LIDAR, 0.1, SENSITIVE_TRACKER), 0
    # After 1.2 s the second person is where the first one started.
    people = [lambda time, start=start: (start + 1.2 * time, 10.8, 1.2, 0.0) for start in (7.0, 5.56)]
    for time, pose, _, rows, _ in drive(tracker, people, 2.5, rng, course=lambda _: Pose2D(8.0, 9.0, math.pi / 2.0)):
        gaps = gaps_between(pose.transform(tracker.bodies[:, :2]), rows)
        missed += (gaps.min(axis=0) > 0.25).sum() if time > 0.25 else 0
    assert missed == 0


def test_the_filter_is_that_of_kalman():
    """Matrix equations for four states, compared with the equations for one axis."""
    params, dt, rng = TrackerParams(), 0.1, np.random.default_rng(6)
    numbers = at.tracker_numbers(LIDAR, params)
    track = np.zeros(at.TRACK_SIZE)
    track[[at.X, at.Y, at.P_XX, at.P_VV]] = 1.0, 2.0, params.position_std**2, at.SPEED_STD**2
    mean = np.array([1.0, 2.0, 0.0, 0.0])
    covariance = np.diag([params.position_std**2] * 2 + [at.SPEED_STD**2] * 2)
    move = np.eye(4) + dt * np.eye(4, k=2)
    one, q = np.eye(2), params.acceleration
    noise = q * np.block([[dt**3 / 3 * one, dt**2 / 2 * one], [dt**2 / 2 * one, dt * one]])
    observe, spread = np.eye(2, 4), params.position_std**2 * one
    for k in range(20):
        mean, covariance = move @ mean, move @ covariance @ move.T + noise
        at.predict(track, dt, numbers)
        if k % 3 != 2:
            measured = np.array([1.0 + 0.1 * k, 2.0]) + rng.normal(0.0, 0.05, 2)
            gain = covariance @ observe.T @ np.linalg.inv(observe @ covariance @ observe.T + spread)
            mean = mean + gain @ (measured - observe @ mean)
            covariance = (np.eye(4) - gain @ observe) @ covariance
            at.correct(track, *measured, numbers)
        assert track[[at.X, at.Y, at.VX, at.VY]] == pytest.approx(mean)
        assert track[[at.P_XX, at.P_XV, at.P_VV]] == pytest.approx(covariance[[0, 0, 2], [0, 2, 2]])


def test_a_copy_goes_on_alike_and_a_reset_forgets():
    rng = np.random.default_rng(7)
    tracker = PeopleTracker(LIDAR, 0.1)
    *_, ranges = [*drive(tracker, walks(4, rng), 5.0, rng)][-1]
    assert len(tracker.people) > 0
    twin = copy.deepcopy(tracker)
    ranges[5:9] = np.nan
    first = tracker.update(ranges, Pose2D(0.1, 0.0, 0.1))
    np.testing.assert_array_equal(twin.update(ranges, Pose2D(0.1, 0.0, 0.1)), first)
    tracker.reset()
    assert tracker.people.shape == (0, 5)
    assert not tracker.is_on_person(ranges, standing=True).any()
