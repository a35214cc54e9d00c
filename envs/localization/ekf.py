"""Extended Kalman filter of pose and velocity for late, missing and outlier measurements.

After Nguyen et al., "A study and design of localization system for mobile robot based on ROS" (2021), equations 1 to
10, with Joseph-form covariance updates, short prediction steps, measurements ordered by time stamp, a state for the
bias of the compass, and measurements of landmarks.
"""

import bisect
import contextlib
import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast, get_args

import numpy as np
from scipy.special import gammaincinv

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle

X, Y, THETA, V, W, BIAS = range(6)
"""State indices: x, y, heading in the map frame [m, m, rad], forward speed [m/s], yaw rate [rad/s], compass bias
[rad]."""
STATE_SIZE = 6
"""Number of states."""
NUM_REPORTED = 5
"""Number of states in `Estimate.covariance`, which leaves out the compass bias, the last one."""
DRIFT = (0.001, 0.001, 0.0005)
"""Process noise: standard deviation of the random walk of x, y, heading after 1 s [m, m, rad]."""
MAX_STEP = 0.002
"""Maximum integration step of the prediction [s]."""
MAX_STEPS = 5000
"""Maximum number of integration steps per prediction."""

TURN_HOLD, TURN_DECAY = 0.25, 0.25
"""Default time without measurements after which the predicted yaw rate decays to zero, and time constant of the decay
[s]. Turns are short: the rate of one moment says nothing about the next seconds."""
GATE, PATIENCE = 0.999, 2.0
"""Probability that a valid measurement passes the chi-square test (outliers are `gated`), and divergence timeout [s]:
after this time with only `gated` measurements of a sensor, its next one is `recovered` with inflated covariance. A map,
landmark or compass measurement stays `gated` if another kind in `LOCATING` was accepted within this time."""
BIAS_PATIENCE = 0.25
"""Time with only `gated` compass measurements after which the next one changes the compass bias [s]."""
DISTURBED, DISTURBED_INTERVAL, DISTURBED_TIME = 3.0, 0.1, 4.0
"""The compass counts as disturbed if the heading of a `map` measurement differs from the estimate by more than this
number of standard deviations, or if `gated` headings change its bias at a known position. The random walk of the
bias then grows to this difference per interval [s], and decays to `bias_drift` with this time constant [s]."""
SHIFTED = np.array([0.0, 0.0, 1.0, 0.0, 0.0, -1.0])
"""Change of the state that the compass does not measure: heading against compass bias."""
MIN_DISTANCE = 1e-3
"""Minimum distance of a landmark; nearer ones have no bearing and are `unusable` [m]."""
MIN_REFUSED, LONE_FACTOR = 5, 5.0
"""A jump of the clock is accepted after at least this number of measurements with refused time stamps. The timeout
`PATIENCE` is multiplied by the factor if only one of several sensors jumps."""

Kind = Literal["map", "encoder", "compass", "landmark"]
KINDS: tuple[Kind, ...] = get_args(Kind)
LOCATING: tuple[Kind, ...] = ("map", "landmark")
"""Sensors of the position. Measurements of one kind, or compass headings, that contradict another of these kinds are
outliers, and no sign of divergence."""
MEASURED: dict[str, np.ndarray] = {
    "map": np.array([X, Y, THETA]),
    "encoder": np.array([V, W]),
    "compass": np.array([THETA, W]),
}
"""Indices of the state components that each sensor measures: nonzero columns of its measurement matrix H, which for the
compass also contains the bias."""
JACOBIANS = {kind: np.eye(STATE_SIZE)[measured] for kind, measured in MEASURED.items()}
JACOBIANS["compass"][0, BIAS] = 1.0
HEADINGS: dict[str, int] = {"map": 2, "encoder": -1, "compass": 0, "landmark": 1}
"""Index of the angle among the values of a measurement, -1 for none."""
Verdict = Literal["accepted", "recovered", "gated", "too_old", "too_new", "unusable"]
"""Verdict of the filter on a measurement: applied (`accepted`, or `recovered` after divergence), outlier (`gated`),
wrong time stamp (`too_old`, `too_new`) or not finite (`unusable`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Time-stamped measurement by one sensor."""

    time: float
    """Time stamp, on a clock shared by all sensors [s]."""
    kind: Kind
    """Sensor: `map` (localization: x, y, heading), `encoder` (speed, yaw rate), `compass` (heading, yaw rate) or
    `landmark` (range and bearing of a reflector or beacon from the base, or only its range)."""
    values: np.ndarray
    """Measured values in the order given at `kind`, shape (k,), float64 [m, rad, m/s, rad/s]."""
    covariance: np.ndarray
    """Covariance of the measurement noise, shape (k, k), float64; positive definite."""
    position: tuple[float, float] | None = None
    """Position (x, y) of the landmark in the map frame [m]; None for the other kinds."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"unknown kind of measurement {self.kind!r}; choose one of {', '.join(KINDS)}")
        for name in ("values", "covariance", "position")[: 3 if self.kind == "landmark" else 2]:
            try:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
            except (TypeError, ValueError):
                raise ValueError(f"{name} must be an array of numbers, got {getattr(self, name)!r}") from None
        size = len(MEASURED[self.kind]) if self.kind in MEASURED else 1 if self.values.shape == (1,) else 2
        place: Any = self.position
        if self.kind == "landmark" and place.shape == (2,) and np.isfinite(place).all():
            object.__setattr__(self, "position", tuple(place.tolist()))
        elif self.kind == "landmark" or place is not None:
            raise ValueError(
                "a landmark has a finite position (x, y), and other kinds have none, "
                f"but a {self.kind} measurement got position={self.position!r}"
            )
        if self.values.shape != (size,) or self.covariance.shape != (size, size):
            raise ValueError(
                f"a {self.kind} measurement has {size} values and a covariance of shape {(size, size)}, "
                f"got shapes {self.values.shape} and {self.covariance.shape}"
            )
        if not math.isfinite(self.time):
            raise ValueError(f"time of a measurement must be finite, got {self.time!r}")


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Estimated pose and velocity of the robot at one time."""

    time: float
    pose: Pose2D
    """Pose of the base in the map frame."""
    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate [rad/s]."""
    covariance: np.ndarray
    """Covariance of x, y, heading, speed and yaw rate, shape (5, 5), float64."""
    compass_bias: float = 0.0
    """Bias of the compass: mean difference of its heading from the true one [rad]."""


@dataclass(slots=True, eq=False)
class _Moment:
    time: float
    measurement: Measurement | None
    verdict: Verdict = "accepted"
    state: np.ndarray = field(default_factory=lambda: np.zeros(STATE_SIZE))
    covariance: np.ndarray = field(default_factory=lambda: np.eye(STATE_SIZE))
    gated_since: dict[str, float] = field(default_factory=dict)
    located: dict[str, float] = field(default_factory=dict)
    """Time of the last accepted measurement, by kind in `LOCATING` [s]."""
    disturbance: float = 0.0
    """Additional spectral density of the compass bias [rad2/s]."""

    @property
    def order(self) -> tuple[Any, ...]:
        sent = self.measurement
        return (self.time, -1) if sent is None else (self.time, KINDS.index(sent.kind), sent.position or ())


class Ekf:
    """Extended Kalman filter for measurements in any order of arrival.

    Late measurements are inserted at their time stamps; newer measurements are applied again. Results are bit-identical
    to ordered arrival.
    """

    def __init__(
        self,
        *,
        acceleration: float = 0.3,
        angular_acceleration: float = 0.6,
        horizon: float = 1.0,
        max_ahead: float = 1.0,
        bias_std: float = 0.0,
        bias_drift: float = 0.0,
        drift: float = DRIFT[0],
        turn_hold: float = TURN_HOLD,
    ) -> None:
        """Initialize at the origin and time 0 with unit variances.

        Args:
            acceleration: root spectral density of forward acceleration noise [m/s2/sqrt(Hz)].
            angular_acceleration: root spectral density of angular acceleration noise [rad/s2/sqrt(Hz)].
            horizon: maximum delay of a measurement [s]; older ones are `too_old`.
            max_ahead: maximum lead of a measurement over the filter's clock [s], or inf; further ones are `too_new`.
                The clock is the latest of the reset, applied measurements and times passed to `estimate`. Two sensors
                that are only `too_new` or only `too_old` for `PATIENCE` reset the clock.
            bias_std: standard deviation of the compass bias at the reset [rad].
            bias_drift: root spectral density of the random walk of the compass bias [rad/sqrt(s)]. With a positive
                value, compass measurements that are only `gated` for `BIAS_PATIENCE` change the bias and not the
                heading, as a magnetic disturbance does.
            drift: root spectral density of the random walk of x and y [m/sqrt(s)].
            turn_hold: time without measurements after which the predicted yaw rate decays to zero [s].

        Raises:
            ValueError: an argument is out of range.
        """
        for name, value in (("acceleration", acceleration), ("angular_acceleration", angular_acceleration)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value!r}")
        at_least_0 = {"horizon": horizon, "bias_std": bias_std, "bias_drift": bias_drift}
        at_least_0 |= {"drift": drift, "turn_hold": turn_hold}
        for name, value in at_least_0.items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value!r}")
        if not max_ahead > 0.0:
            raise ValueError(f"max_ahead must be positive, got {max_ahead!r}")
        self._horizon, self._max_ahead, self._turn_hold = horizon, max_ahead, turn_hold
        self._noise = np.square([drift, drift, DRIFT[2], acceleration, angular_acceleration, bias_drift])
        self._bias_std = bias_std
        self._gates = [float(2.0 * gammaincinv(0.5 * size, GATE)) for size in range(1, 4)]
        self.reset(Pose2D(0.0, 0.0, 0.0), np.eye(NUM_REPORTED))

    def reset(
        self, pose: Pose2D, covariance: np.ndarray, *, v: float = 0.0, w: float = 0.0, time: float | None = None
    ) -> None:
        """Restart at a pose (map frame), speed [m/s], yaw rate [rad/s] and time [s].

        `covariance`: of x, y, heading, speed and yaw rate, shape (5, 5). Without a time, the first measurement sets the
        clock.

        Raises:
            ValueError: a value is not finite, or the covariance is invalid.
        """
        clock, time = (math.inf, 0.0) if time is None else (time, time)
        state = np.array([pose.x, pose.y, float(wrap_angle(pose.theta)), v, w, 0.0])
        if not (np.isfinite(state).all() and math.isfinite(time)):
            raise ValueError(f"pose, v, w and time must be finite, got {tuple(pose)}, {v!r}, {w!r}, {time!r}")
        covariance = np.array(covariance, dtype=np.float64)
        _require_covariance(covariance, NUM_REPORTED)
        covariance = np.pad(covariance, (0, 1))
        covariance[BIAS, BIAS] = self._bias_std**2
        self._moments = [_Moment(time, None, "accepted", state, covariance)]
        self._counts: Counter[tuple[str, Verdict]] = Counter()
        self._clock, self._kinds = clock, set[Kind]()
        self._refused: dict[Kind, list[float]] = {}
        self._refused_as: Verdict | None = None

    @property
    def time(self) -> float:
        """Time of the newest measurement in the history, or of the reset [s]."""
        return self._moments[-1].time

    @property
    def counts(self) -> dict[str, dict[Verdict, int]]:
        """Number of measurements since the reset, by sensor and verdict, such as `accepted`."""
        counts = self._counts + _tally(self._moments)
        return {kind: {verdict: n for (of, verdict), n in counts.items() if of == kind} for kind in KINDS}

    def add(self, measurement: Measurement) -> Verdict:
        """Apply a measurement; return the verdict: `accepted`, or a reason, such as `gated` for outliers.

        Raises:
            ValueError: invalid covariance.
        """
        if not np.isfinite(measurement.values).all():
            self._counts[measurement.kind, "unusable"] += 1
            return "unusable"
        _require_covariance(measurement.covariance, len(measurement.values))
        self._kinds.add(measurement.kind)
        if (verdict := self._judge_stamp(measurement)) is not None:
            self._counts[measurement.kind, verdict] += 1
            return verdict
        self._refused.clear()
        if math.isinf(self._clock):
            self._clock = measurement.time
        added = _Moment(measurement.time, measurement)
        index = bisect.bisect_right(self._moments, added.order, key=lambda moment: moment.order)
        before, newer = self._moments[index - 1], [added, *map(replace, self._moments[index:])]
        for moment in newer:
            self._apply(before, moment)
            before = moment
        self._moments[index:] = newer
        # Keep one state before the horizon for late measurements.
        oldest = self.time - self._horizon
        keep = max(bisect.bisect_left(self._moments, oldest, key=lambda moment: moment.time) - 1, 0)
        self._counts.update(_tally(self._moments[:keep]))
        del self._moments[:keep]
        return added.verdict

    def _judge_stamp(self, measurement: Measurement) -> Verdict | None:
        time, verdict = measurement.time, cast(Verdict, "too_old")
        if time >= max(self._moments[0].time, self.time - self._horizon):
            if time <= max(self.time, self._clock) + self._max_ahead:
                return None
            verdict = "too_new"
        if verdict != self._refused_as:
            self._refused.clear()
        self._refused_as = verdict
        self._refused.setdefault(measurement.kind, []).append(time)
        patience = PATIENCE
        if len(self._kinds) > 1 and len(self._refused) == 1:
            if verdict == "too_old":
                return verdict
            patience *= LONE_FACTOR
        count = sum(stamps[-1] - stamps[0] >= patience for stamps in self._refused.values())
        if (count < len(self._refused) and count < 2) or sum(map(len, self._refused.values())) < MIN_REFUSED:
            return verdict
        if verdict == "too_old":
            last = self._moments[-1]
            self._counts.update(_tally(self._moments))
            self._moments = [_Moment(time, None, "accepted", last.state, last.covariance)]
            self._clock = time
        return None

    def estimate(self, time: float | None = None) -> Estimate:
        """Return the state estimate at a time [s], by default the time of the newest measurement.

        Later times are predicted and advance the filter's clock. Earlier times ignore newer measurements.

        Raises:
            ValueError: the time is not finite, or before the history.
        """
        time = self.time if time is None else time
        index = bisect.bisect_right(self._moments, time, key=lambda moment: moment.time)
        if index == 0 or not math.isfinite(time):
            raise ValueError(f"the filter's history starts at {self._moments[0].time:.3f} s, got {time!r} s")
        self._clock = max(self._clock, time)
        state, covariance = self._predict(self._moments[index - 1], time)
        x, y, theta, v, w, bias = state.tolist()
        covariance = covariance[:NUM_REPORTED, :NUM_REPORTED]
        return Estimate(time, Pose2D(x, y, theta), v, w, 0.5 * (covariance + covariance.T), bias)

    def _predict(self, before: _Moment, time: float) -> tuple[np.ndarray, np.ndarray]:
        state, covariance = before.state.copy(), before.covariance.copy()
        if time > before.time:
            noise = self._noise
            if before.disturbance > 0.0:
                noise = noise + before.disturbance * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            predict(state, covariance, time - before.time, noise, MAX_STEP, self._turn_hold)
        return state, covariance

    def _apply(self, before: _Moment, after: _Moment) -> None:
        measurement = after.measurement
        assert measurement is not None
        kind, noise = measurement.kind, measurement.covariance
        state, covariance = self._predict(before, after.time)
        after.state, after.covariance, after.gated_since = state, covariance, dict(before.gated_since)
        after.disturbance = before.disturbance * math.exp((before.time - after.time) / DISTURBED_TIME)
        after.located = before.located
        if measurement.position is None:
            jacobian = JACOBIANS[kind]
            expected = jacobian @ state
        else:
            expected, jacobian = see_landmark(state, *measurement.position)
            expected, jacobian = expected[: len(noise)], jacobian[: len(noise)]
        after.verdict = "unusable"
        if not np.isfinite(expected).all():
            return
        compared = expected, jacobian, measurement.values, noise, HEADINGS[kind]
        innovation, spread, length = _innovation_of(covariance, *compared)
        if not math.isfinite(length):
            return
        has_bias = self._noise[BIAS] > 0.0
        if kind == "map" and has_bias and innovation[2] ** 2 > DISTURBED**2 * spread[2, 2]:
            shifted = covariance + innovation[2] ** 2 * np.outer(SHIFTED, SHIFTED)
            found = _innovation_of(shifted, *compared)
            if found[2] <= self._gates[2]:
                covariance[:], (innovation, spread, length) = shifted, found
                after.disturbance = max(after.disturbance, innovation[2] ** 2 / DISTURBED_INTERVAL)
        if length > self._gates[len(noise) - 1]:
            since = after.gated_since.setdefault(kind, after.time)
            is_bias = kind == "compass" and has_bias
            rivals = () if kind == "encoder" else (after.located.get(of) for of in LOCATING if of != kind)
            is_located = any(time is not None and after.time - time <= PATIENCE for time in rivals)
            patience = BIAS_PATIENCE if is_bias else PATIENCE
            if (is_located and not is_bias) or after.time - since < patience or after.time == since:
                after.verdict = "gated"
                return
            # Inflate the prior to the size of the innovation.
            inflation = innovation**2 @ jacobian**2
            inflation[: BIAS if is_bias else 0] = 0.0
            inflation[BIAS] *= is_bias
            if is_bias and is_located:
                after.disturbance = max(after.disturbance, innovation[0] ** 2 / DISTURBED_INTERVAL)
            covariance += np.diag(inflation)
            innovation, spread, length = _innovation_of(covariance, *compared)
            after.verdict = "recovered"
        else:
            after.verdict = "accepted"
        after.gated_since.pop(kind, None)
        if kind in LOCATING:
            after.located = {**before.located, kind: after.time}
        after.covariance = _correct(state, covariance, jacobian, innovation, spread, noise)


def _tally(moments: list[_Moment]) -> Counter[tuple[str, Verdict]]:
    return Counter((each.measurement.kind, each.verdict) for each in moments if each.measurement is not None)


def _require_covariance(covariance: np.ndarray, size: int) -> None:
    if covariance.shape == (size, size) and np.abs(covariance - covariance.T).max() <= 1e-9 * np.abs(covariance).max():
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(covariance)
            return
    raise ValueError(
        f"covariance must be symmetric and positive definite, of shape {(size, size)}, got {covariance.tolist()}"
    )


@njit(cache=True, error_model="numpy")
def predict(state, covariance, duration, noise, max_step, turn_hold):
    """Predict state and covariance in place, `duration` [s] ahead: equations (2) and (3), P = F P F^T + Q.

    `noise`: spectral density of each state's process noise, shape (6,) [squared unit / s]. Speed and yaw rate change at
    the end, because encoders measure their means, and also during the prediction after `turn_hold` [s].
    """
    num_steps = min(max(math.ceil(duration / max_step - 1e-6), 1), MAX_STEPS)
    dt = duration / num_steps
    for step in range(num_steps):
        c, s = math.cos(state[THETA]), math.sin(state[THETA])
        turn_x, turn_y = -state[V] * dt * s, state[V] * dt * c
        state[X] += state[V] * dt * c
        state[Y] += state[V] * dt * s
        state[THETA] += state[W] * dt
        # F P by rows, then (F P) F^T by columns; five elements of F differ from the identity.
        for j in range(STATE_SIZE):
            covariance[X, j] += turn_x * covariance[THETA, j] + dt * c * covariance[V, j]
            covariance[Y, j] += turn_y * covariance[THETA, j] + dt * s * covariance[V, j]
            covariance[THETA, j] += dt * covariance[W, j]
        for i in range(STATE_SIZE):
            covariance[i, X] += turn_x * covariance[i, THETA] + dt * c * covariance[i, V]
            covariance[i, Y] += turn_y * covariance[i, THETA] + dt * s * covariance[i, V]
            covariance[i, THETA] += dt * covariance[i, W]
            if step * dt >= turn_hold or (i != V and i != W):
                covariance[i, i] += noise[i] * dt
        if step * dt >= turn_hold:
            decay = math.exp(-dt / TURN_DECAY)
            state[W] *= decay
            covariance[W] *= decay
            covariance[:, W] *= decay
    covariance[V, V] += noise[V] * min(duration, turn_hold)
    covariance[W, W] += noise[W] * min(duration, turn_hold)
    state[THETA] = wrap_angle(state[THETA])


@njit(cache=True, error_model="numpy")
def see_landmark(state, x, y):
    """Return range and bearing of a landmark at (x, y) from the base, shape (2,), and their Jacobian, shape (2, 6).

    Both are NaN within `MIN_DISTANCE`.
    """
    dx, dy = x - state[X], y - state[Y]
    distance = math.hypot(dx, dy)
    jacobian = np.zeros((2, STATE_SIZE))
    if distance < MIN_DISTANCE:
        return np.full(2, np.nan), np.full_like(jacobian, np.nan)
    jacobian[0, X], jacobian[0, Y] = -dx / distance, -dy / distance
    jacobian[1, X], jacobian[1, Y], jacobian[1, THETA] = dy / distance**2, -dx / distance**2, -1.0
    return np.array([distance, wrap_angle(math.atan2(dy, dx) - state[THETA])]), jacobian


@njit(cache=True, error_model="numpy")
def _innovation_of(covariance, expected, jacobian, values, noise, heading):
    innovation = values - expected
    if 0 <= heading < innovation.shape[0]:
        innovation[heading] = wrap_angle(innovation[heading])
    spread = np.dot(np.dot(jacobian, covariance), np.ascontiguousarray(jacobian.T)) + noise
    return innovation, spread, np.dot(innovation, np.linalg.solve(spread, innovation))


@njit(cache=True, error_model="numpy")
def _correct(state, covariance, jacobian, innovation, spread, noise):
    rows = np.dot(jacobian, covariance)
    gain = np.ascontiguousarray(np.linalg.solve(spread, rows).T)
    state += np.dot(gain, innovation)
    state[THETA], state[BIAS] = wrap_angle(state[THETA]), wrap_angle(state[BIAS])
    kept = np.eye(STATE_SIZE) - np.dot(gain, jacobian)
    corrected = kept @ covariance @ kept.T + gain @ noise @ gain.T
    return 0.5 * (corrected + corrected.T)
