"""An extended Kalman filter over pose and velocity that tolerates late, missing and wrong measurements.

State (position, heading, forward speed, yaw rate), prediction and measurements (pose on the map, wheel encoders,
compass, each at its own rate) are those of Nguyen et al., "A study and design of localization system for mobile robot
based on ROS" (2021), equations 1 to 10. Three things differ: covariances are updated in Joseph's form, which keeps them
positive definite; predictions are cut into short steps, because equation (3) drives straight for a whole step; and
measurements are ordered by the time at which they were taken, not by that of their arrival.
"""

import bisect
import contextlib
import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, cast, get_args

import numpy as np
from numba import njit
from scipy.special import gammaincinv

from lidarnaut.envs.geometry import Pose2D, wrap_angle

X, Y, THETA, V, W = range(5)
"""Entries of the state: pose in the map frame [m, m, rad], forward speed [m/s], yaw rate [rad/s]."""
STATE_SIZE = 5
"""Number of entries of the state."""
DRIFT = (0.001, 0.001, 0.0005)
"""Standard deviations of position and heading after 1 s from sources other than the velocities [m, m, rad]."""
MAX_STEP = 0.002
"""Longest step of the prediction [s]."""
MAX_STEPS = 5000
"""Greatest number of steps of a prediction; after a long time without measurements they become longer."""

MIN_REFUSED, LONE_FACTOR = 5, 5.0
"""Least number of refused measurements in succession that set the clock; factor on `patience` if they are all of one
kind of several."""

Kind = Literal["map", "encoder", "compass"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Kinds of measurement."""
MEASURED: dict[str, np.ndarray] = {
    "map": np.array([X, Y, THETA]),
    "encoder": np.array([V, W]),
    "compass": np.array([THETA, W]),
}
"""Entries of the state that each kind measures: the rows of H in equations (5), (7) and (9)."""
Verdict = Literal["accepted", "recovered", "gated", "too_old", "too_new", "unusable"]
"""Outcome of a measurement; see `Ekf`."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Measurement of a part of the state."""

    time: float
    """When it was taken, by the clock that all measurements share [s]."""
    kind: Kind
    """Sensor: `map` (x, y, heading), `encoder` (speed, yaw rate) or `compass` (heading, yaw rate)."""
    values: np.ndarray
    """Shape (k,), float64 [m, rad, m/s, rad/s]; with NaN or infinity in it the measurement is `unusable`."""
    covariance: np.ndarray
    """Shape (k, k), float64, of the values' errors; symmetric and positive definite."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"unknown kind of measurement {self.kind!r}; choose one of {', '.join(KINDS)}")
        size = len(MEASURED[self.kind])
        if self.values.shape != (size,) or self.covariance.shape != (size, size):
            raise ValueError(
                f"a {self.kind} measurement has {size} values and a covariance of shape {(size, size)}, "
                f"got shapes {self.values.shape} and {self.covariance.shape}"
            )
        if not math.isfinite(self.time):
            raise ValueError(f"time of a measurement must be finite, got {self.time!r}")


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """State estimate."""

    time: float
    """Time of the estimate [s]."""
    pose: Pose2D
    """Pose of the base in the map frame."""
    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate [rad/s]."""
    covariance: np.ndarray
    """Shape (5, 5), float64, of x, y, heading, speed and yaw rate."""


@dataclass(slots=True, eq=False)
class _Moment:
    """State of the filter after a measurement."""

    time: float
    measurement: Measurement | None
    verdict: Verdict = "accepted"
    state: np.ndarray = field(default_factory=lambda: np.zeros(STATE_SIZE))
    covariance: np.ndarray = field(default_factory=lambda: np.eye(STATE_SIZE))
    gated_since: dict[str, float] = field(default_factory=dict)
    """By kind: since when all of its measurements have been gated [s]."""

    @property
    def order(self) -> tuple[float, int]:
        """Sort key: time, then kind; a reset comes first."""
        return self.time, -1 if self.measurement is None else KINDS.index(self.measurement.kind)


class Ekf:
    """Fuses measurements, in whatever order they arrive, into a pose with its covariance.

    The filter keeps its last `horizon` seconds. A late measurement is inserted at its time and later ones are applied
    again, so that the result equals that of measurements in order, to the last bit.
    """

    def __init__(
        self,
        *,
        acceleration: float = 0.3,
        angular_acceleration: float = 0.6,
        horizon: float = 1.0,
        gate: float = 0.999,
        patience: float = 2.0,
        max_ahead: float = 1.0,
    ) -> None:
        """Build a filter at the origin at time 0, with variances of one in SI units; see `reset`.

        Args:
            acceleration: root of the spectral density of forward acceleration [m/s2/sqrt(Hz)]: the speed's deviation
                after 1 s.
            angular_acceleration: that of angular acceleration [rad/s2/sqrt(Hz)].
            horizon: how late a measurement may arrive [s]. Later ones are rejected, and counted as `too_old`.
            gate: share of true measurements that pass the chi-square gate; rejected ones are counted as `gated`.
            patience: once all measurements of a kind have been gated for this long [s], the filter counts as diverged:
                it inflates the covariance of what that kind measures and accepts the next one, which is counted as
                `recovered`. See also `max_ahead`.
            max_ahead: greatest lead of a measurement over the filter's clock [s]; inf for no bound. Measurements beyond
                it are rejected and counted as `too_new`: a single one would make all others `too_old`. The clock is the
                latest of the reset, the newest measurement in use and the times passed to `estimate`. If no
                measurement is used while stamps of two kinds that are too new, or too old, advance by `patience`, the
                filter follows them: the clock was set, or the sensors were silent. If measurements are regularly
                farther apart than `max_ahead`, set a larger bound, or call `estimate` with the time first.

        Raises:
            ValueError: an argument is out of range.
        """
        for name, value in (("acceleration", acceleration), ("angular_acceleration", angular_acceleration)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value!r}")
        for name, value in (("horizon", horizon), ("patience", patience)):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value!r}")
        if not max_ahead > 0.0:
            raise ValueError(f"max_ahead must be positive, got {max_ahead!r}")
        if not 0.0 < gate < 1.0:
            raise ValueError(f"gate must lie in (0, 1), got {gate!r}")
        self._horizon, self._patience, self._max_ahead = horizon, patience, max_ahead
        self._noise = np.square([*DRIFT, acceleration, angular_acceleration])
        # Quantiles of the chi-squared distribution.
        self._gates = {kind: float(2.0 * gammaincinv(0.5 * len(MEASURED[kind]), gate)) for kind in KINDS}
        self.reset(Pose2D(0.0, 0.0, 0.0), np.eye(STATE_SIZE))

    def reset(
        self, pose: Pose2D, covariance: np.ndarray, *, v: float = 0.0, w: float = 0.0, time: float | None = None
    ) -> None:
        """Start anew at a time [s].

        For pose, speed, yaw rate and covariance see `Estimate`. Without a time it is 0, and the first measurement may
        have any later stamp.

        Raises:
            ValueError: something is not finite, or the covariance is not symmetric and positive definite.
        """
        clock, time = (math.inf, 0.0) if time is None else (time, time)
        state = np.array([pose.x, pose.y, float(wrap_angle(pose.theta)), v, w])
        if not (np.isfinite(state).all() and math.isfinite(time)):
            raise ValueError(f"pose, v, w and time must be finite, got {tuple(pose)}, {v!r}, {w!r}, {time!r}")
        covariance = np.array(covariance, dtype=np.float64)
        _require_covariance(covariance, STATE_SIZE)
        self._moments = [_Moment(time, None, "accepted", state, covariance)]
        self._counts: Counter[tuple[str, Verdict]] = Counter()
        self._clock, self._kinds = clock, set[Kind]()
        self._refused: dict[Kind, list[float]] = {}
        self._refused_as: Verdict | None = None

    @property
    def time(self) -> float:
        """Time of the newest measurement that was not rejected, or of the reset [s]."""
        return self._moments[-1].time

    @property
    def counts(self) -> dict[str, dict[Verdict, int]]:
        """Number of measurements since the reset, by kind and verdict."""
        counts = self._counts + _tally(self._moments)
        return {kind: {verdict: n for (of, verdict), n in counts.items() if of == kind} for kind in KINDS}

    def add(self, measurement: Measurement) -> Verdict:
        """Apply a measurement, and return whether it was used.

        Raises:
            ValueError: its covariance is not symmetric and positive definite.
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
        self._moments.insert(index, added)
        for k in range(index, len(self._moments)):
            self._apply(self._moments[k - 1], self._moments[k])
        # But for the last one, from which late measurements are predicted, moments before the horizon are dropped.
        oldest = self.time - self._horizon
        keep = max(bisect.bisect_left(self._moments, oldest, key=lambda moment: moment.time) - 1, 0)
        self._counts.update(_tally(self._moments[:keep]))
        del self._moments[:keep]
        return added.verdict

    def _judge_stamp(self, measurement: Measurement) -> Verdict | None:
        """Return `too_old` or `too_new`, or None if the stamp can be used.

        Measurements that are refused in succession show that the filter's clock is wrong, and set it, if they come from
        two kinds, or the only one, and advance by `patience`; those of one kind of several if they advance by
        `LONE_FACTOR` times as much, and are ahead.
        """
        time, verdict = measurement.time, cast(Verdict, "too_old")
        if time >= max(self._moments[0].time, self.time - self._horizon):
            if time <= max(self.time, self._clock) + self._max_ahead:
                return None
            verdict = "too_new"
        if verdict != self._refused_as:
            self._refused.clear()
        self._refused_as = verdict
        self._refused.setdefault(measurement.kind, []).append(time)
        patience = self._patience
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
        """Return the estimate at a time [s], by default that of the newest measurement.

        Later times are predicted, and advance the clock that `max_ahead` refers to; for earlier ones only measurements
        until then count.

        Raises:
            ValueError: the filter does not remember the time any more.
        """
        time = self.time if time is None else time
        index = bisect.bisect_right(self._moments, time, key=lambda moment: moment.time)
        if index == 0 or not math.isfinite(time):
            raise ValueError(f"the filter remembers from {self._moments[0].time:.3f} s on, got {time!r} s")
        self._clock = max(self._clock, time)
        state, covariance = self._predict(self._moments[index - 1], time)
        x, y, theta, v, w = state.tolist()
        return Estimate(time, Pose2D(x, y, theta), v, w, 0.5 * (covariance + covariance.T))

    def _predict(self, before: _Moment, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return state and covariance at a time [s] that is not before a moment."""
        state, covariance = before.state.copy(), before.covariance.copy()
        if time > before.time:
            predict(state, covariance, time - before.time, self._noise, MAX_STEP)
        return state, covariance

    def _apply(self, before: _Moment, after: _Moment) -> None:
        """Predict from one moment to the next, and update by the measurement of that one if it passes the gate."""
        measurement = after.measurement
        assert measurement is not None
        kind, measured, noise = measurement.kind, MEASURED[measurement.kind], measurement.covariance
        state, covariance = self._predict(before, after.time)
        innovation, spread, length = _innovation_of(state, covariance, measured, measurement.values, noise)
        after.state, after.covariance, after.gated_since = state, covariance, dict(before.gated_since)
        if length > self._gates[kind]:
            since = after.gated_since.setdefault(kind, after.time)
            if after.time - since < self._patience or after.time == since:
                after.verdict = "gated"
                return
            # With a prior as uncertain as the innovation is large, the measurement decides.
            covariance[measured, measured] += innovation**2
            spread[np.diag_indices(len(measured))] += innovation**2
            after.verdict = "recovered"
        else:
            after.verdict = "accepted"
        after.gated_since.pop(kind, None)
        after.covariance = _correct(state, covariance, measured, innovation, spread, noise)


def _tally(moments: list[_Moment]) -> Counter[tuple[str, Verdict]]:
    """Count measurements by kind and verdict."""
    return Counter((each.measurement.kind, each.verdict) for each in moments if each.measurement is not None)


def _require_covariance(covariance: np.ndarray, size: int) -> None:
    """Raise a ValueError unless this is a covariance of `size` values."""
    if covariance.shape == (size, size) and np.abs(covariance - covariance.T).max() <= 1e-9 * np.abs(covariance).max():
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(covariance)
            return
    raise ValueError(
        f"covariance must be symmetric and positive definite, of shape {(size, size)}, got {covariance.tolist()}"
    )


@njit(cache=True, error_model="numpy")
def predict(state, covariance, duration, noise, max_step):
    """Predict the state and its covariance in place: equations (2) and (3), and P = F P F^T + Q.

    Takes a `duration` in steps of at most `max_step` [s]; `noise`, shape (5,), float64, are the spectral densities of
    the process noise [unit^2/s].
    """
    num_steps = min(max(math.ceil(duration / max_step - 1e-6), 1), MAX_STEPS)
    dt = duration / num_steps
    for _ in range(num_steps):
        c, s = math.cos(state[THETA]), math.sin(state[THETA])
        turn_x, turn_y = -state[V] * dt * s, state[V] * dt * c
        state[X] += state[V] * dt * c
        state[Y] += state[V] * dt * s
        state[THETA] += state[W] * dt
        # F differs from the identity in five entries: first F P, row by row, then (F P) F^T, column by column.
        for j in range(STATE_SIZE):
            covariance[X, j] += turn_x * covariance[THETA, j] + dt * c * covariance[V, j]
            covariance[Y, j] += turn_y * covariance[THETA, j] + dt * s * covariance[V, j]
            covariance[THETA, j] += dt * covariance[W, j]
        for i in range(STATE_SIZE):
            covariance[i, X] += turn_x * covariance[i, THETA] + dt * c * covariance[i, V]
            covariance[i, Y] += turn_y * covariance[i, THETA] + dt * s * covariance[i, V]
            covariance[i, THETA] += dt * covariance[i, W]
            covariance[i, i] += noise[i] * dt
    state[THETA] = wrap_angle(state[THETA])


@njit(cache=True, error_model="numpy")
def _innovation_of(state, covariance, measured, values, noise):
    """Return the innovation of the entries `measured`, its covariance S, and its normalised square (NIS).

    The NIS is chi-square distributed if the filter is consistent.
    """
    size = measured.shape[0]
    innovation, spread = np.empty(size), np.empty((size, size))
    for i in range(size):
        innovation[i] = values[i] - state[measured[i]]
        if measured[i] == THETA:
            innovation[i] = wrap_angle(innovation[i])
        for j in range(size):
            spread[i, j] = covariance[measured[i], measured[j]] + noise[i, j]
    return innovation, spread, np.dot(innovation, np.linalg.solve(spread, innovation))


@njit(cache=True, error_model="numpy")
def _correct(state, covariance, measured, innovation, spread, noise):
    """Update the state in place by a measurement; return the covariance, in Joseph's form."""
    size = measured.shape[0]
    rows = np.empty((size, STATE_SIZE))
    for i in range(size):
        rows[i] = covariance[measured[i]]
    gain = np.ascontiguousarray(np.linalg.solve(spread, rows).T)
    state += np.dot(gain, innovation)
    state[THETA] = wrap_angle(state[THETA])
    kept = np.eye(STATE_SIZE)
    for i in range(size):
        kept[:, measured[i]] -= gain[:, i]
    corrected = kept @ covariance @ kept.T + gain @ noise @ gain.T
    return 0.5 * (corrected + corrected.T)
