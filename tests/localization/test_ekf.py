import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.localization.ekf import DRIFT, MEASURED, Ekf, Measurement, see_landmark

KINDS = tuple(MEASURED)

SPREAD = np.array([*DRIFT, 0.3, 0.6])
"""Square roots of the densities of the process noise."""
NOISE = {
    "map": np.diag([0.02, 0.02, 0.01]) ** 2,
    "encoder": np.diag([0.02, 0.04]) ** 2,
    "compass": np.diag([0.001, 0.03]) ** 2,
}
START = np.diag([0.05, 0.05, 0.02, 0.1, 0.1]) ** 2
ORIGIN = Pose2D(0.0, 0.0, 0.0)


def measure(time, kind, *values):
    return Measurement(time, kind, np.array(values, dtype=float), NOISE[kind])


def started(pose=ORIGIN, v=0.0, w=0.0, **params):
    ekf = Ekf(**params)
    ekf.reset(pose, START, v=v, w=w)
    return ekf


def slow_predict(state, covariance, duration, noise, num_steps):
    """Equations (2) and (3) of the paper, with whole matrices; noise of speed and yaw rate at the end."""
    dt = duration / num_steps
    start = np.array([1, 1, 1, 0, 0]) * noise
    for _ in range(num_steps):
        x, y, theta, v, w = state
        F = np.array(
            [
                [1, 0, -v * dt * math.sin(theta), dt * math.cos(theta), 0],
                [0, 1, v * dt * math.cos(theta), dt * math.sin(theta), 0],
                [0, 0, 1, 0, dt],
                [0, 0, 0, 1, 0],
                [0, 0, 0, 0, 1],
            ]
        )
        state = np.array([x + v * dt * math.cos(theta), y + v * dt * math.sin(theta), theta + w * dt, v, w])
        covariance = F @ covariance @ F.T + np.diag(start) * dt
    return state, covariance + np.diag(noise - start) * duration


def slow_correct(state, covariance, kind, values, R):
    """Update of the paper, with an inverse."""
    H = np.eye(5)[MEASURED[kind]]
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + R)
    innovation = values - H @ state
    if kind != "encoder":
        angle = list(MEASURED[kind]).index(2)
        innovation[angle] = (innovation[angle] + math.pi) % (2 * math.pi) - math.pi
    state = state + K @ innovation
    state[2] = (state[2] + math.pi) % (2 * math.pi) - math.pi
    return state, covariance - K @ H @ covariance


def test_a_run_of_measurements_equals_the_textbook():
    rng = np.random.default_rng(1)
    ekf, noise = started(v=0.5, gate=1.0 - 1e-15), np.square(SPREAD)
    state, covariance, time = np.array([0.0, 0.0, 0.0, 0.5, 0.0]), START.copy(), 0.0
    for _ in range(60):
        kind, dt = KINDS[rng.integers(3)], 0.002 * rng.integers(1, 40)
        values = state[MEASURED[kind]] + rng.multivariate_normal(np.zeros(len(NOISE[kind])), NOISE[kind])
        state, covariance = slow_predict(state, covariance, dt, noise, round(dt / 0.002))
        state, covariance = slow_correct(state, covariance, kind, values, NOISE[kind])
        time += dt
        assert ekf.add(Measurement(time, kind, values, NOISE[kind])) == "accepted"
        estimate = ekf.estimate()
        np.testing.assert_allclose([*estimate.pose, estimate.v, estimate.w], state, atol=1e-8)
        np.testing.assert_allclose(estimate.covariance, covariance, atol=1e-8)


@pytest.mark.parametrize("kind", ["map", "compass"])
def test_headings_are_compared_across_the_turn(kind):
    ekf = started(pose=Pose2D(0.0, 0.0, math.pi - 0.01))
    values = {"map": (0.0, 0.0, -math.pi + 0.01), "compass": (-math.pi + 0.01, 0.0)}[kind]
    assert ekf.add(measure(0.01, kind, *values)) == "accepted"
    theta = ekf.estimate().pose.theta
    assert abs(wrap_angle(theta - math.pi)) < 0.011
    assert -math.pi <= theta < math.pi


def drive_measurements(seed, duration=4.0, v=0.5, w=0.4):
    """Measurements of a steady arc, each kind at its own rate and with its stated noise."""
    rng = np.random.default_rng(seed)
    measurements = []
    for kind, period in (("encoder", 1 / 17), ("compass", 1 / 10), ("map", 0.31)):
        for time in np.arange(period, duration, period):
            truth = np.array([v / w * math.sin(w * time), v / w * (1 - math.cos(w * time)), w * time, v, w])
            values = truth[MEASURED[kind]] + rng.multivariate_normal(np.zeros(len(NOISE[kind])), NOISE[kind])
            measurements.append(Measurement(float(time), kind, values, NOISE[kind]))
    return sorted(measurements, key=lambda measurement: measurement.time)


def test_late_measurements_change_nothing():
    measurements = drive_measurements(3)
    in_order, shuffled = started(v=0.5, w=0.4), started(v=0.5, w=0.4)
    for measurement in measurements:
        in_order.add(measurement)
    rng = np.random.default_rng(0)
    delays = {"encoder": 0.0, "compass": 0.1, "map": 0.9}
    for measurement in sorted(measurements, key=lambda m: m.time + delays[m.kind] * rng.random()):
        assert shuffled.add(measurement) == "accepted"
    one, other = in_order.estimate(), shuffled.estimate()
    assert one.pose == other.pose
    assert (one.v, one.w) == (other.v, other.w)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert in_order.counts == shuffled.counts
    assert sum(sum(counts.values()) for counts in shuffled.counts.values()) == len(measurements)
    assert shuffled.add(measure(shuffled.time, "map", 9.0, 9.0, 0.0)) == "gated"
    assert shuffled.estimate().pose == one.pose


def test_too_late_and_missing_ones_are_refused_and_counted():
    ekf = started(horizon=0.5)
    assert ekf.add(measure(0.1, "compass", math.nan, 0.0)) == "unusable"
    assert ekf.time == 0.0
    ekf.add(measure(2.0, "encoder", 0.0, 0.0))
    before = ekf.estimate()
    assert ekf.add(measure(1.4, "map", 5.0, 5.0, 1.0)) == "too_old"
    assert ekf.add(measure(1.6, "compass", 0.0, 0.0)) == "accepted"
    expected = {"map": {"too_old": 1}, "encoder": {"accepted": 1}, "compass": {"accepted": 1, "unusable": 1}}
    assert ekf.counts == {**expected, "landmark": {}}
    assert before.pose == pytest.approx(ekf.estimate().pose, abs=1e-3)
    ekf.reset(ORIGIN, START)  # after a clock was set back
    assert ekf.add(measure(0.1, "encoder", 0.3, 0.0)) == "accepted"


def test_silence_is_survived_and_costs_certainty():
    ekf = started(v=0.5)
    ekf.add(measure(1.0, "compass", 0.0, 0.0))
    before, after = ekf.estimate(), ekf.estimate(31.0)
    assert after.pose.x == pytest.approx(before.pose.x + 15.0, abs=0.5)
    assert after.covariance[0, 0] > 100 * before.covariance[0, 0]
    assert ekf.add(measure(31.0, "map", 13.0, 2.0, 0.3)) == "accepted"
    assert ekf.estimate().pose == pytest.approx((13.0, 2.0, 0.3), abs=0.05)


def test_the_filter_recovers_from_a_kidnapped_robot():
    ekf = started(patience=2.0)
    verdicts = []
    for k in range(1, 60):
        time = 0.1 * k
        ekf.add(measure(time, "encoder", 0.0, 0.0))
        verdicts.append(ekf.add(measure(time, "map", 3.0, -2.0, 1.0)))
    assert verdicts[:20] == ["gated"] * 20
    assert verdicts[20] == "recovered"
    assert verdicts[21:] == ["accepted"] * 38
    assert ekf.estimate().pose == pytest.approx((3.0, -2.0, 1.0), abs=0.01)


def drive_and_stop(stamp, num=100, kinds=("encoder", "compass"), **params):
    """Drive at 0.5 m/s for 5 s, then stop; `stamp` maps kind and true time of a measurement to its stamps, if any."""
    ekf = started(v=0.5, **params)
    for k in range(1, num + 1):
        for kind in kinds:
            for time in stamp(kind, 0.1 * k):
                ekf.add(measure(time, kind, 0.5 * (k <= 50) if kind == "encoder" else 0.0, 0.0))
    return ekf


@pytest.mark.parametrize("ahead", [1.6, 20.0, 1e9])
@pytest.mark.parametrize("culprit", KINDS)
def test_one_stamp_from_the_future_is_refused_and_nothing_else(culprit, ahead):
    ekf = drive_and_stop(lambda kind, time: [time])
    for k in range(1, 101):
        time = 10.0 + 0.1 * k
        assert ekf.add(measure(time, "encoder", 0.0, 0.0)) == "accepted"
        if k in (50, 51):
            assert ekf.add(measure(time + ahead, culprit, *(9.0,) * len(NOISE[culprit]))) == "too_new"
            assert ekf.time == time
    assert ekf.estimate().pose.x == pytest.approx(2.5, abs=0.1)
    assert ekf.counts[culprit]["too_new"] == 2


def test_a_sensor_whose_clock_is_ahead_never_silences_the_others():
    ekf = drive_and_stop(lambda kind, time: [time + 20.0 * (kind == "compass")])
    assert ekf.counts["compass"] == {"too_new": 100}
    assert set(ekf.counts["encoder"]) <= {"accepted", "gated"}
    assert ekf.estimate().pose.x == pytest.approx(2.5, abs=0.1)


@pytest.mark.parametrize("kinds", [("encoder",), ("encoder", "compass")])
def test_clocks_set_forward_and_silent_sensors_are_followed(kinds):
    ekf = drive_and_stop(lambda kind, time: [time + 20.0 * (time > 5.55)], 400, kinds)
    assert ekf.time == pytest.approx(60.0)
    for kind in kinds:
        assert 18 <= ekf.counts[kind]["too_new"] <= 21  # for `patience`
    assert (ekf.estimate().v, ekf.estimate().w) == pytest.approx((0.0, 0.0), abs=0.02)
    assert ekf.add(measure(61.0, "map", 2.5, 0.0, 0.0)) == "accepted"


def test_measurements_far_apart():
    rare = started(v=0.5)
    assert [rare.add(measure(5.0 * k, "encoder", 0.5, 0.0)) for k in range(1, 7)] == [
        "accepted",
        *["too_new"] * 4,
        "accepted",
    ]
    bounded, asked = started(v=0.5, max_ahead=math.inf), started(v=0.5)
    for k in range(1, 7):
        asked.estimate(5.0 * k - 0.5)
        assert asked.add(measure(5.0 * k, "encoder", 0.5, 0.0)) == "accepted"
        assert bounded.add(measure(5.0 * k, "encoder", 0.5, 0.0)) == "accepted"


def test_the_first_stamp_is_compared_with_the_time_of_the_reset():
    ekf = started()
    assert ekf.add(measure(1.7e9, "encoder", 0.5, 0.0)) == "accepted"
    assert ekf.add(measure(1.7e9 + 20.0, "encoder", 0.5, 0.0)) == "too_new"
    ekf.reset(ORIGIN, START, time=100.0)
    assert ekf.add(measure(102.0, "encoder", 0.5, 0.0)) == "too_new"
    assert ekf.add(measure(100.9, "encoder", 0.5, 0.0)) == "accepted"


def drive(ekf, stamps, seconds=20.0):
    """Drive at 0.5 m/s with all measurements at 10 Hz; return the final position error [m].

    `stamps` maps kind and true time of a measurement to its stamp.
    """
    for k in range(1, round(10 * seconds) + 1):
        time = 0.1 * k
        values = {"encoder": (0.5, 0.0), "compass": (0.0, 0.0), "map": (0.5 * time, 0.0, 0.0)}
        for kind in KINDS:
            if (stamp := stamps(kind, time)) is not None:
                ekf.add(measure(stamp, kind, *values[kind]))
    return abs(ekf.estimate().pose.x - 0.5 * seconds)


@pytest.mark.parametrize(
    ("stamps", "has_clock"),
    [
        # Two wrong stamps in succession, of one sensor or of two.
        (lambda kind, t: {5.0: t + 20.0, 5.1: t + 23.0}.get(round(t, 1), t) if kind == "compass" else t, True),
        (lambda kind, t: t + {"compass": 20.0, "map": 40.0}.get(kind, 0.0) * (round(t, 1) == 5.0), True),
        # One sensor is 20 s ahead while the others are silent for 3 s.
        (lambda kind, t: t + 20.0 if kind == "compass" else None if 5.0 < t < 8.0 else t, True),
        # The first stamp after a reset without a time is wrong.
        (lambda kind, t: t + 500.0 if kind == KINDS[0] and t < 0.15 else t, False),
        # All clocks are set forward or back.
        (lambda kind, t: t + 100.0 * (t > 5.0), True),
        (lambda kind, t: t + 100.0 * (t < 5.0), False),
    ],
)
def test_wrong_clocks_cost_no_good_measurements_for_long(stamps, has_clock):
    ekf = Ekf()
    ekf.reset(ORIGIN, START, time=0.0 if has_clock else None)
    assert drive(ekf, stamps) < 0.3
    assert sum(ekf.counts["encoder"].get(verdict, 0) for verdict in ("too_old", "too_new")) < 30


positive = st.floats(1e-3, 3.0)
measurements = st.tuples(
    st.floats(-0.5, 3.0),
    st.sampled_from((*KINDS, "landmark")),
    st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3),
    st.lists(positive, min_size=3, max_size=3),
    st.floats(-0.9, 0.9),
)


def test_single_outliers_far_apart_never_pass_for_a_recovery():
    ekf = started(max_ahead=5.0)
    for k in range(10):
        assert ekf.add(measure(5.0 * k + 2.5, "map", 0.0, 0.0, 0.0)) == "accepted"
        assert ekf.add(measure(5.0 * k + 2.6, "map", 50.0, 0.0, 0.0)) == "gated"


@given(
    st.lists(measurements, max_size=25), st.floats(0.5, 1.0 - 1e-9), st.floats(0.0, 2.0), st.sampled_from([0.0, 0.01])
)
@settings(deadline=None, max_examples=150)
def test_covariance_stays_symmetric_and_positive_definite(sequence, gate, patience, bias):
    ekf = started(gate=gate, patience=patience, max_ahead=3.0, bias_std=bias, bias_drift=bias)
    for delay, kind, values, spreads, correlation in sequence:
        size, position = (2, (1.0, 0.5)) if kind == "landmark" else (len(MEASURED[kind]), None)
        noise = np.diag(np.square(spreads[:size]))
        noise[0, 1] = noise[1, 0] = correlation * spreads[0] * spreads[1]
        verdict = ekf.add(Measurement(ekf.time + delay, kind, np.array(values[:size]), noise, position))
        assert verdict in ("accepted", "recovered", "gated", "too_old")
        for estimate in (ekf.estimate(), ekf.estimate(ekf.time + 0.5)):
            assert (estimate.covariance == estimate.covariance.T).all()
            assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0
            assert -math.pi <= estimate.pose.theta < math.pi
    assert sum(sum(counts.values()) for counts in ekf.counts.values()) == len(sequence)


@pytest.mark.parametrize(
    ("say", "culprit"),
    [
        (lambda: Ekf(gate=1.0), "gate"),
        (lambda: Ekf(acceleration=0.0), "acceleration"),
        (lambda: Ekf(horizon=-1.0), "horizon"),
        (lambda: Ekf(bias_std=-0.1), "bias_std"),
        (lambda: Ekf(bias_drift=math.inf), "bias_drift"),
        (lambda: Measurement(0.0, "landmark", np.zeros(2), np.eye(2)), "landmark has a finite position"),
        (lambda: Measurement(0.0, "encoder", np.zeros(2), np.eye(2), (1.0, 2.0)), "encoder measurement got position"),
        (lambda: Measurement(0.0, "landmark", np.zeros(3), np.eye(3), (1.0, 2.0)), "landmark measurement has 2 values"),
        (lambda: Measurement(0.0, "landmark", np.zeros(2), np.eye(2), (1.0, 2.0, 0.0)), "position"),
        (lambda: Measurement(0.0, "landmark", np.zeros(2), np.eye(2), 2.0), "finite position"),
        (lambda: Measurement(0.0, "landmark", np.zeros(2), np.eye(2), ("a", "b")), "position must be an array"),
        (lambda: Measurement(0.0, "landmark", np.zeros(2), np.eye(2), (math.nan, 0.0)), "finite position"),
        (lambda: Measurement(0.0, "map", np.zeros(3), np.eye(3), (math.nan, 0.0)), "position="),
        (lambda: Measurement(0.0, "encoder", ["a", "b"], np.eye(2)), "values must be an array of numbers"),
        (lambda: Measurement(0.0, "encoder", np.zeros(2), "x"), "covariance must be an array of numbers"),
        (lambda: Ekf(drift=-1.0), "drift"),
        (lambda: Ekf(turn_hold=math.nan), "turn_hold"),
        (lambda: Ekf(max_ahead=0.0), "max_ahead"),
        (lambda: Ekf(max_ahead=math.nan), "max_ahead"),
        (lambda: Measurement(0.0, "gps", np.zeros(3), np.eye(3)), "unknown kind of measurement 'gps'"),
        (lambda: Measurement(0.0, "encoder", np.zeros(3), np.eye(3)), "encoder measurement has 2 values"),
        (lambda: Measurement(math.nan, "encoder", np.zeros(2), np.eye(2)), "time"),
        (lambda: Ekf().reset(ORIGIN, np.eye(4)), "symmetric and positive definite"),
        (lambda: Ekf().reset(Pose2D(math.nan, 0.0, 0.0), np.eye(5)), "finite"),
        (lambda: started().estimate(-1.0), "history starts"),
    ],
)
def test_what_makes_no_sense_is_named(say, culprit):
    with pytest.raises(ValueError, match=culprit):
        say()


@pytest.mark.parametrize("covariance", [[[1.0, 0.5], [0.0, 1.0]], np.diag([1.0, -1.0]), np.full((2, 2), np.nan)])
def test_covariances_of_measurements_must_be_positive_definite(covariance):
    with pytest.raises(ValueError, match="symmetric and positive definite"):
        started().add(Measurement(0.1, "encoder", np.zeros(2), np.array(covariance)))


@pytest.mark.parametrize("pose", [(0.3, -0.2, 0.4), (0.3, -0.2, math.pi - 0.01), (5.0, 2.0, -3.0)])
@pytest.mark.parametrize("place", [(4.0, 1.0), (-3.0, -0.2), (0.3, 0.05)])
def test_the_jacobian_of_a_landmark_equals_the_numeric_one(pose, place):
    state = np.array([*pose, 0.5, 0.1, 0.02])
    seen, jacobian = see_landmark(state, *place)
    assert seen[0] == pytest.approx(math.dist(pose[:2], place))
    numeric = np.empty((2, 6))
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        after, before = see_landmark(state + step, *place)[0], see_landmark(state - step, *place)[0]
        numeric[:, k] = (after[0] - before[0]) / 2e-6, wrap_angle(after[1] - before[1]) / 2e-6
    np.testing.assert_allclose(jacobian, numeric, atol=1e-6)


LANDMARKS = [(3.0, 0.0), (-2.0, 1.0), (0.5, 4.0)]
"""Ahead of, behind and beside the robot."""


def look(rng, time, pose, num_values, std=(0.05, 0.02)):
    measurements = []
    for x, y in LANDMARKS:
        bearing = math.atan2(y - pose[1], x - pose[0]) - pose[2] + std[1] * rng.standard_normal()
        values = np.array([math.dist(pose[:2], (x, y)) + std[0] * rng.standard_normal(), float(wrap_angle(bearing))])
        covariance = np.diag(np.square(std))[:num_values, :num_values]
        measurements.append(Measurement(time, "landmark", values[:num_values], covariance, (x, y)))
    return measurements


@pytest.mark.parametrize("num_values", [1, 2])
def test_landmarks_alone_give_an_honest_pose(num_values):
    nees, errors = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        start = rng.multivariate_normal(np.zeros(5), START)
        ekf = started()
        truth = np.array([*start[:3], 0.3, 0.0])
        ekf.reset(ORIGIN, START, v=truth[3], time=0.0)
        for time in np.arange(0.1, 3.0, 0.1):
            pose = truth[:3] + (0.3 * time * math.cos(truth[2]), 0.3 * time * math.sin(truth[2]), 0.0)
            for measurement in look(rng, time, pose, num_values):
                ekf.add(measurement)
        estimate = ekf.estimate()
        error = np.array(estimate.pose) - pose
        error[2] = wrap_angle(error[2])
        errors.append(error)
        nees.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error))
    x, y, theta = np.sqrt(np.mean(np.square(errors), axis=0))
    assert max(x, y) < 0.05
    assert theta < {1: 0.3, 2: 0.05}[num_values]
    # The speed is noisier in the model than in truth, so the filter is on the safe side.
    assert 1.0 < np.mean(nees) < 3.8


def test_late_landmarks_change_nothing():
    rng = np.random.default_rng(4)
    sent = [one for k in range(1, 20) for one in look(rng, 0.05 * k, (0.0, 0.0, 0.0), 2)]
    in_order, shuffled = started(), started()
    for one in sent:
        in_order.add(one)
    for k in rng.permutation(len(sent)):
        assert shuffled.add(sent[k]) == "accepted"
    assert in_order.estimate().pose == shuffled.estimate().pose
    assert in_order.estimate().pose == pytest.approx((0.0, 0.0, 0.0), abs=0.06)


def test_landmarks_across_the_turn_at_the_robot_and_out_of_place():
    ekf = started(Pose2D(0.0, 0.0, math.pi - 0.01))
    noise = np.diag([0.05, 0.02]) ** 2
    behind = Measurement(0.01, "landmark", np.array([2.0, math.pi - 0.01]), noise, (2.0, 0.0))
    assert ekf.add(behind) == "accepted"
    assert abs(wrap_angle(ekf.estimate().pose.theta - math.pi)) < 0.03
    here = tuple(ekf.estimate().pose[:2])
    assert started().add(Measurement(0.0, "landmark", np.array([0.0, 0.0]), noise, (0.0, 0.0))) == "unusable"
    assert ekf.add(Measurement(0.02, "landmark", np.array([9.0, 0.0]), noise, (2.0, 0.0))) == "gated"
    assert tuple(ekf.estimate().pose[:2]) == pytest.approx(here, abs=1e-3)


def drive_with_compass(error, num=400, **params):
    """Stand at the origin with a map measurement every 0.1 s; return the largest heading error and the filter."""
    ekf, rng, worst = Ekf(**params), np.random.default_rng(0), 0.0
    ekf.reset(ORIGIN, START, time=0.0)
    for k in range(1, num + 1):
        time = 0.05 * k
        ekf.add(measure(time, "encoder", 0.0, 0.0))
        ekf.add(measure(time, "compass", error(time) + 0.001 * rng.standard_normal(), 0.0))
        if k % 2 == 0:
            values = 0.5 * np.sqrt(np.diag(NOISE["map"])) * rng.standard_normal(3)
            ekf.add(measure(time, "map", *values))
        if time > 2.0:
            worst = max(worst, abs(ekf.estimate().pose.theta))
    return worst, ekf


@pytest.mark.parametrize("error", [lambda t: 0.3 * (t > 5.0), lambda t: 0.05 * t, lambda t: 0.2 * math.sin(0.5 * t)])
def test_a_disturbed_compass_changes_its_bias_and_not_the_heading(error):
    worst, ekf = drive_with_compass(error, bias_std=0.001, bias_drift=0.0001)
    assert worst < 0.04
    assert ekf.estimate().compass_bias == pytest.approx(error(20.0), abs=0.04)
    # Without the bias, a compass that contradicts the map stays gated.
    assert "recovered" not in drive_with_compass(error)[1].counts["compass"]


def test_an_undisturbed_compass_keeps_its_weight():
    worst, ekf = drive_with_compass(lambda t: 0.0, bias_std=0.001, bias_drift=0.0001)
    assert worst < 0.003
    assert ekf.counts["compass"]["accepted"] == 400


def test_the_predicted_turn_ends_when_measurements_are_missing():
    ekf = started(v=0.5)
    for k in range(1, 20):
        ekf.add(measure(0.05 * k, "encoder", 0.5, 0.4))
    turned = [ekf.estimate(ekf.time + ahead).pose.theta - ekf.estimate().pose.theta for ahead in (0.2, 5.0)]
    assert turned[0] == pytest.approx(0.08, abs=0.01)
    assert turned[1] == pytest.approx(0.4 * 0.5, abs=0.03)


def test_lists_integers_and_single_precision_become_double_precision():
    exact, other = started(), started()
    exact.add(Measurement(0.1, "landmark", np.array([2.0, 0.0]), np.eye(2), (2.0, 1.0)))
    for values, covariance, position in (
        ([2, 0], [[1, 0], [0, 1]], np.array([2, 1])),
        (np.array([2, 0], np.float32), np.eye(2, dtype=np.float32), [2.0, 1.0]),
    ):
        measurement = Measurement(0.1, "landmark", values, covariance, position)
        assert measurement.values.dtype == measurement.covariance.dtype == np.float64
        assert measurement.position == (2.0, 1.0)
        other.reset(ORIGIN, START)
        assert other.add(measurement) == "accepted"
        assert other.estimate().pose == exact.estimate().pose


def test_failed_and_overflowing_measurements_change_nothing():
    ekf = started()
    ekf.add(measure(0.1, "map", 0.0, 0.0, 0.0))
    ekf.add(measure(0.2, "map", 0.0, 0.0, 0.0))
    before, counts = ekf.estimate(0.3), ekf.counts
    with pytest.raises(ValueError, match="covariance"):
        ekf.add(Measurement(0.15, "map", np.zeros(3), np.zeros((3, 3))))
    assert ekf.counts == counts
    for far in (1e300, 1.7e308):
        assert ekf.add(Measurement(0.15, "landmark", np.array([2.0, 0.0]), np.eye(2), (far, far))) == "unusable"
    after = ekf.estimate(0.3)
    assert after.pose == pytest.approx(before.pose)
    np.testing.assert_allclose(np.diag(after.covariance)[:3], np.diag(before.covariance)[:3], rtol=0.2)


@pytest.mark.parametrize("silent_map", [False, True])
def test_a_landmark_out_of_place_recovers_only_without_a_map(silent_map):
    ekf, rng, verdicts = started(), np.random.default_rng(0), set()
    for k in range(1, 100):
        if not (silent_map and k > 20):
            ekf.add(measure(0.1 * k, "map", *rng.normal(0.0, 0.01, 3)))
        verdicts.add(ekf.add(Measurement(0.1 * k, "landmark", np.array([5.0, 0.0]), np.eye(2) * 1e-4, (2.0, 0.0))))
    assert ("recovered" in verdicts) == silent_map
    assert (abs(ekf.estimate().pose.x) < 0.1) == (not silent_map)


def test_an_unusable_landmark_keeps_the_disturbance_of_the_compass():
    heads = []
    for has_landmark in (False, True):
        ekf = started(bias_std=0.01, bias_drift=0.001)
        for k in range(1, 20):
            ekf.add(measure(0.1 * k, "map", 0.0, 0.0, 0.0))
            ekf.add(measure(0.1 * k, "compass", 0.0, 0.0))
        ekf.add(measure(2.0, "map", 0.0, 0.0, 0.05))
        if has_landmark:
            here = tuple(ekf.estimate().pose[:2])
            assert ekf.add(Measurement(2.0, "landmark", np.zeros(2), np.eye(2), here)) == "unusable"
        heads.append(ekf.estimate(2.5).compass_bias)
        ekf.add(measure(2.5, "compass", 0.03, 0.0))
        heads.append(ekf.estimate().compass_bias)
    assert heads[:2] == pytest.approx(heads[2:], abs=1e-9)
