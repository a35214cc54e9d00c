import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.localization import ekf as ekf_module
from lidarnaut.envs.localization.ekf import DRIFT, HEADINGS, MEASURED, Ekf, Measurement, see_landmark

KINDS = tuple(MEASURED)

SPREAD = np.array([*DRIFT, 0.3, 0.6])
"""Square roots of the densities of the process noise."""
STDS = {"map": [0.02, 0.02, 0.01], "encoder": [0.02, 0.04], "compass": [0.001, 0.03], "landmark": [0.05, 0.02]}
NOISE = {kind: np.diag(std) ** 2 for kind, std in STDS.items()}
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


def seen_from(state, kind, landmark):
    """Expected values, and the measurement matrix H."""
    if kind == "landmark":
        values, jacobian = see_landmark(np.append(state, 0.0), *landmark)
        return values, jacobian[:, :5]
    H = np.eye(5)[MEASURED[kind]]
    return H @ state, H


def slow_correct(state, covariance, measurement):
    """Update of the paper, with an inverse."""
    values, R, angle = measurement.values, measurement.covariance, HEADINGS[measurement.kind]
    expected, H = (part[: len(values)] for part in seen_from(state, measurement.kind, measurement.position))
    K = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + R)
    innovation = values - expected
    if 0 <= angle < len(values):
        innovation[angle] = wrap_angle(innovation[angle])
    state = state + K @ innovation
    state[2] = wrap_angle(state[2])
    return state, covariance - K @ H @ covariance


def test_a_run_of_measurements_across_half_a_turn_equals_the_textbook(monkeypatch):
    monkeypatch.setattr(ekf_module, "GATE", 1.0 - 1e-15)
    rng, start = np.random.default_rng(1), Pose2D(0.0, 0.0, math.pi - 0.0005)
    ekf, noise = started(start, v=0.5), np.square(SPREAD)
    state, covariance, time = np.array([*start, 0.5, 0.0]), START.copy(), 0.0
    for _ in range(80):
        kind, dt, landmark = rng.choice(list(NOISE)), 0.002 * rng.integers(1, 40), None
        num_values = len(NOISE[kind])
        if kind == "landmark":  # beside, ahead of or behind the robot, also by its range alone
            landmark, num_values = [(0.5, 4.0), (-3.0, 0.0), (2.0, 0.1)][rng.integers(3)], rng.integers(1, 3)
        values = rng.multivariate_normal(seen_from(state, kind, landmark)[0], NOISE[kind])[:num_values]
        if 0 <= HEADINGS[kind] < num_values:
            values[HEADINGS[kind]] = wrap_angle(values[HEADINGS[kind]])
        time += dt
        sent = Measurement(time, kind, values, NOISE[kind][:num_values, :num_values], landmark)
        state, covariance = slow_predict(state, covariance, dt, noise, round(dt / 0.002))
        state, covariance = slow_correct(state, covariance, sent)
        assert ekf.add(sent) == "accepted"
        estimate = ekf.estimate()
        np.testing.assert_allclose([*estimate.pose, estimate.v, estimate.w], state, atol=1e-8)
        np.testing.assert_allclose(estimate.covariance, covariance, atol=1e-8)


def drive_measurements(seed, duration=4.0, v=0.5, w=0.4):
    """Measurements of a steady arc, each kind at its own rate and with its stated noise."""
    rng = np.random.default_rng(seed)
    measurements = []
    for kind, period in (("encoder", 1 / 17), ("compass", 1 / 10), ("map", 0.31), ("landmark", 0.23)):
        landmark = (3.0, 1.0) if kind == "landmark" else None
        for time in np.arange(period, duration, period):
            truth = np.array([v / w * math.sin(w * time), v / w * (1 - math.cos(w * time)), w * time, v, w])
            values = rng.multivariate_normal(seen_from(truth, kind, landmark)[0], NOISE[kind])
            measurements.append(Measurement(float(time), kind, values, NOISE[kind], landmark))
    return sorted(measurements, key=lambda measurement: measurement.time)


def test_late_measurements_change_nothing():
    measurements, rng = drive_measurements(3), np.random.default_rng(0)
    in_order, shuffled = started(v=0.5, w=0.4), started(v=0.5, w=0.4)
    for measurement in measurements:
        in_order.add(measurement)
    delays = {"encoder": 0.0, "compass": 0.1, "map": 0.9, "landmark": 0.9}
    for measurement in sorted(measurements, key=lambda m: m.time + delays[m.kind] * rng.random()):
        assert shuffled.add(measurement) == "accepted"
    one, other = in_order.estimate(), shuffled.estimate()
    assert (one.pose, one.v, one.w) == (other.pose, other.v, other.w)
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
    ekf = started()
    verdicts = []
    for k in range(1, 60):
        time = 0.1 * k
        ekf.add(measure(time, "encoder", 0.0, 0.0))
        verdicts.append(ekf.add(measure(time, "map", 3.0, -2.0, 1.0)))
    assert verdicts[:20] == ["gated"] * 20
    assert verdicts[20] == "recovered"
    assert verdicts[21:] == ["accepted"] * 38
    assert ekf.estimate().pose == pytest.approx((3.0, -2.0, 1.0), abs=0.01)


def test_measurements_far_apart():
    rare = started(v=0.5)
    verdicts = [rare.add(measure(5.0 * k, "encoder", 0.5, 0.0)) for k in range(1, 7)]
    assert verdicts == ["accepted", *["too_new"] * 4, "accepted"]
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
    assert ekf.add(measure(101.1, "encoder", 0.5, 0.0)) == "too_new"
    assert ekf.time == 100.0
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


def once(*jumps, at=(5.0,)):
    """Stamps that are wrong at some times: `jumps` (kind, seconds)."""
    return lambda kind, t: t + dict(jumps).get(kind, 0.0) * (round(t, 1) in at)


NONE, AFTER_PATIENCE = range(1), range(18, 22)


@pytest.mark.parametrize(
    ("stamps", "has_clock", "refused"),
    [
        (once(("encoder", 1e9)), True, range(1, 2)),
        (once(("map", 1.6), at=(5.0, 5.1)), True, NONE),
        (once(("compass", 20.0), ("map", 40.0)), True, NONE),
        (lambda kind, t: {5.0: t + 20.0, 5.1: t + 23.0}.get(round(t, 1), t) if kind == "compass" else t, True, NONE),
        # One sensor is 20 s ahead, always or while the others are silent for 3 s.
        (lambda kind, t: t + 20.0 * (kind == "compass"), True, NONE),
        (lambda kind, t: t + 20.0 if kind == "compass" else None if 5.0 < t < 8.0 else t, True, AFTER_PATIENCE),
        # The first stamp after a reset without a time is wrong.
        (lambda kind, t: t + 500.0 if kind == KINDS[0] and t < 0.15 else t, False, range(30)),
        # All clocks are set forward or back.
        (lambda kind, t: t + 100.0 * (t > 5.0), True, AFTER_PATIENCE),
        (lambda kind, t: t + 100.0 * (t < 5.0), False, AFTER_PATIENCE),
    ],
)
def test_wrong_clocks_cost_no_good_measurements_for_long(stamps, has_clock, refused):
    ekf = Ekf()
    ekf.reset(ORIGIN, START, time=0.0 if has_clock else None)
    assert drive(ekf, stamps) < 0.3
    assert sum(ekf.counts["encoder"].get(verdict, 0) for verdict in ("too_old", "too_new")) in refused


def test_the_clock_of_a_lone_sensor_is_followed_after_patience():
    ekf = started(v=0.5)
    stamps = [(0.1 * k + 20.0 * (k > 55), 0.5 * (k <= 50)) for k in range(1, 200)]
    verdicts = [ekf.add(measure(time, "encoder", v, 0.0)) for time, v in stamps]
    assert verdicts.count("too_new") in AFTER_PATIENCE
    assert (ekf.estimate().v, ekf.estimate().w) == pytest.approx((0.0, 0.0), abs=0.02)


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


@given(st.lists(measurements, max_size=25), st.sampled_from([0.0, 0.01]))
@settings(deadline=None, max_examples=150)
def test_covariance_stays_symmetric_and_positive_definite(sequence, bias):
    ekf = started(max_ahead=3.0, bias_std=bias, bias_drift=bias)
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


BAD_PARAMS = [
    *(("acceleration", 0.0), ("horizon", -1.0), ("bias_std", -0.1), ("bias_drift", math.inf)),
    *(("drift", -1.0), ("turn_hold", math.nan), ("max_ahead", 0.0), ("max_ahead", math.nan)),
]


@pytest.mark.parametrize(("name", "value"), BAD_PARAMS)
def test_params_that_make_no_sense_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        Ekf(**{name: value})


@pytest.mark.parametrize(
    ("kind", "values", "covariance", "position", "culprit"),
    [
        ("landmark", np.zeros(2), np.eye(2), None, "landmark has a finite position"),
        ("encoder", np.zeros(2), np.eye(2), (1.0, 2.0), "encoder measurement got position"),
        ("landmark", np.zeros(3), np.eye(3), (1.0, 2.0), "landmark measurement has 2 values"),
        ("landmark", np.zeros(2), np.eye(2), (1.0, 2.0, 0.0), "position"),
        ("landmark", np.zeros(2), np.eye(2), 2.0, "finite position"),
        ("landmark", np.zeros(2), np.eye(2), ("a", "b"), "position must be an array"),
        ("landmark", np.zeros(2), np.eye(2), (math.nan, 0.0), "finite position"),
        ("map", np.zeros(3), np.eye(3), (math.nan, 0.0), "position="),
        ("encoder", ["a", "b"], np.eye(2), None, "values must be an array of numbers"),
        ("encoder", np.zeros(2), "x", None, "covariance must be an array of numbers"),
        ("gps", np.zeros(3), np.eye(3), None, "unknown kind of measurement 'gps'"),
        ("encoder", np.zeros(3), np.eye(3), None, "encoder measurement has 2 values"),
        ("encoder", np.zeros(2), [[1.0, 0.5], [0.0, 1.0]], None, "symmetric and positive definite"),
        ("encoder", np.zeros(2), np.diag([1.0, -1.0]), None, "symmetric and positive definite"),
        ("encoder", np.zeros(2), np.full((2, 2), np.nan), None, "symmetric and positive definite"),
    ],
)
def test_measurements_that_make_no_sense_are_named(kind, values, covariance, position, culprit):
    with pytest.raises(ValueError, match=culprit):
        started().add(Measurement(0.1, kind, values, covariance, position))


def test_times_and_starts_that_make_no_sense_are_named():
    with pytest.raises(ValueError, match="time"):
        Measurement(math.nan, "encoder", np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="symmetric and positive definite"):
        Ekf().reset(ORIGIN, np.eye(4))
    with pytest.raises(ValueError, match="finite"):
        Ekf().reset(Pose2D(math.nan, 0.0, 0.0), np.eye(5))
    with pytest.raises(ValueError, match="history starts"):
        started().estimate(-1.0)


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


def test_landmarks_at_the_robot_are_unusable_and_those_out_of_place_are_outliers():
    ekf, noise = started(), NOISE["landmark"]
    assert ekf.add(Measurement(0.0, "landmark", np.array([0.0, 0.0]), noise, (0.0, 0.0))) == "unusable"
    assert ekf.add(Measurement(0.02, "landmark", np.array([9.0, 0.0]), noise, (2.0, 0.0))) == "gated"
    assert ekf.estimate().pose == pytest.approx(ORIGIN, abs=1e-3)


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


STEP, RAMP, WAVE = lambda t: 0.3 * (t > 5.0), lambda t: 0.05 * t, lambda t: 0.2 * math.sin(0.5 * t)


@pytest.mark.parametrize(("error", "limit"), [(STEP, 0.04), (RAMP, 0.04), (WAVE, 0.04), (lambda t: 0.0, 0.003)])
def test_a_disturbed_compass_changes_its_bias_and_not_the_heading(error, limit):
    worst, ekf = drive_with_compass(error, bias_std=0.001, bias_drift=0.0001)
    assert worst < limit
    assert limit > 0.003 or ekf.counts["compass"]["accepted"] == 400
    assert ekf.estimate().compass_bias == pytest.approx(error(20.0), abs=0.04)
    # Without the bias, a compass that contradicts the map stays gated.
    assert "recovered" not in drive_with_compass(error)[1].counts["compass"]


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
