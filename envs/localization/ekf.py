"""An extended Kalman filter over pose and velocity that survives late, missing and wrong measurements.

State, prediction and measurements are those of seed 4 (equations 1 to 10): position, heading, forward speed and yaw
rate; a map's pose, wheel encoders and a compass, each whenever it has something to say. Three things are done
otherwise: covariances are corrected in Joseph's form, which keeps them positive definite; the step from one measurement
to the next is cut into short ones, because equation (3) drives straight for a whole step; and measurements are put in
order by the time at which they were taken, not by the time at which they arrive.
"""

import bisect
import contextlib
import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from scipy.stats import chi2

from envs.geometry import Pose2D, wrap_angle

from .ekf_kernels import STATE_SIZE, THETA, V, W, X, Y, correct, innovation_of, predict

Kind = Literal["map", "encoder", "compass"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""What can be measured."""
MEASURED: dict[str, np.ndarray] = {
    "map": np.array([X, Y, THETA]),
    "encoder": np.array([V, W]),
    "compass": np.array([THETA, W]),
}
"""Entries of the state that each kind measures: the rows of H in equations (5), (7) and (9)."""
Verdict = Literal["accepted", "recovered", "gated", "too_old", "unusable"]
"""What became of a measurement; `EkfParams` tells what leads to which."""


@dataclass(frozen=True, slots=True)
class EkfParams:
    """How much the filter trusts its model, and whom it does not believe."""

    acceleration: float = 0.3
    """Root of the spectral density of forward acceleration [m/s2/sqrt(Hz)]: by how much the speed wanders in 1 s."""
    angular_acceleration: float = 0.6
    """The same for the yaw rate [rad/s2/sqrt(Hz)]."""
    position_drift: float = 0.001
    """By how much the position wanders in 1 s beside what the speed does, along either axis [m]."""
    heading_drift: float = 0.0005
    """By how much the heading wanders in 1 s beside what the yaw rate does [rad]."""
    max_step: float = 0.002
    """Longest step of the prediction [s]."""
    horizon: float = 1.0
    """How late a measurement may come [s]. Later ones are refused, and counted as `too_old`."""
    gate: float = 0.999
    """Share of true measurements that the chi-square gate lets pass; what it stops is counted as `gated`."""
    patience: float = 2.0
    """Once everything of a kind has been stopped for this long, the filter takes itself to be wrong: it forgets what it
    believed of what that kind measures, and takes the measurement, which is counted as `recovered` [s]."""

    def __post_init__(self) -> None:
        for name in ("acceleration", "angular_acceleration", "position_drift", "heading_drift", "max_step"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)!r}")
        for name in ("horizon", "patience"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {getattr(self, name)!r}")
        if not 0.0 < self.gate < 1.0:
            raise ValueError(f"gate must lie in (0, 1), got {self.gate!r}")


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Something that a sensor says of the state."""

    time: float
    """When it was taken, by the clock that all measurements share [s]."""
    kind: Kind
    """Which sensor: `map` (x, y, heading), `encoder` (speed, yaw rate) or `compass` (heading, yaw rate)."""
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
    """What the filter believes."""

    time: float
    """Of what moment [s]."""
    pose: Pose2D
    """Of the base, in the map frame."""
    v: float
    """Forward speed [m/s]."""
    w: float
    """Yaw rate [rad/s]."""
    covariance: np.ndarray
    """Shape (5, 5), float64, of x, y, heading, speed and yaw rate."""


@dataclass(slots=True, eq=False)
class _Moment:
    """The filter right after a measurement."""

    time: float
    measurement: Measurement | None
    verdict: Verdict = "accepted"
    state: np.ndarray = field(default_factory=lambda: np.zeros(STATE_SIZE))
    covariance: np.ndarray = field(default_factory=lambda: np.eye(STATE_SIZE))
    stopped_since: dict[str, float] = field(default_factory=dict)
    """For each kind of which nothing passes the gate: since when [s]."""

    @property
    def order(self) -> tuple[float, int]:
        """By what moments are sorted: time, and at the same instant the kind; a reset comes first."""
        return self.time, -1 if self.measurement is None else KINDS.index(self.measurement.kind)


class Ekf:
    """Fuses measurements into a pose with its covariance, whatever their order.

    The filter remembers its last `horizon` seconds. A late measurement is put where it belongs, and what came after it
    is done again, so that the result is that of measurements in order, to the last bit.
    """

    def __init__(self, params: EkfParams = EkfParams()) -> None:
        """Make a filter that believes to stand at the origin at time 0, within a metre and a radian; see `reset`."""
        self.params = params
        drift, turn = params.position_drift, params.heading_drift
        self._noise = np.square([drift, drift, turn, params.acceleration, params.angular_acceleration])
        self._gates = {kind: float(chi2.ppf(params.gate, len(MEASURED[kind]))) for kind in KINDS}
        self.reset(Pose2D(0.0, 0.0, 0.0), np.eye(STATE_SIZE))

    def reset(self, pose: Pose2D, covariance: np.ndarray, *, v: float = 0.0, w: float = 0.0, time: float = 0.0) -> None:
        """Forget everything and start anew; also what to do once the clock has been set back.

        Args:
            pose: of the base, in the map frame.
            covariance: shape (5, 5), float64, of x, y, heading, speed and yaw rate.
            v: forward speed [m/s].
            w: yaw rate [rad/s].
            time: of all this [s].

        Raises:
            ValueError: something is not finite, or the covariance is not symmetric and positive definite.
        """
        state = np.array([pose.x, pose.y, float(wrap_angle(pose.theta)), v, w])
        if not (np.isfinite(state).all() and math.isfinite(time)):
            raise ValueError(f"pose, v, w and time must be finite, got {tuple(pose)}, {v!r}, {w!r}, {time!r}")
        covariance = np.array(covariance, dtype=np.float64)
        _require_covariance(covariance, STATE_SIZE)
        self._moments = [_Moment(time, None, "accepted", state, covariance)]
        self._counts: dict[str, Counter[Verdict]] = {kind: Counter() for kind in KINDS}

    @property
    def time(self) -> float:
        """Time of the newest measurement that was not refused, or of the reset [s]."""
        return self._moments[-1].time

    @property
    def counts(self) -> dict[str, dict[Verdict, int]]:
        """For each kind how many measurements met with which verdict since the reset."""
        counts = {kind: Counter(counter) for kind, counter in self._counts.items()}
        for moment in self._moments:
            if moment.measurement is not None:
                counts[moment.measurement.kind][moment.verdict] += 1
        return {kind: dict(counter) for kind, counter in counts.items()}

    def add(self, measurement: Measurement) -> Verdict:
        """Take in a measurement and say what became of it.

        Raises:
            ValueError: its covariance is not symmetric and positive definite.
        """
        if not np.isfinite(measurement.values).all():
            self._counts[measurement.kind]["unusable"] += 1
            return "unusable"
        _require_covariance(measurement.covariance, len(measurement.values))
        if measurement.time < max(self._moments[0].time, self.time - self.params.horizon):
            self._counts[measurement.kind]["too_old"] += 1
            return "too_old"
        added = _Moment(measurement.time, measurement)
        place = bisect.bisect_right(self._moments, added.order, key=lambda moment: moment.order)
        self._moments.insert(place, added)
        for k in range(place, len(self._moments)):
            self._follow(self._moments[k - 1], self._moments[k])
        self._forget()
        return added.verdict

    def estimate(self, time: float | None = None) -> Estimate:
        """Return what the filter believes of a moment, by default of that of the newest measurement.

        Later moments are predicted. For earlier ones only what was measured until then counts.

        Raises:
            ValueError: the moment lies before what the filter remembers.
        """
        time = self.time if time is None else time
        place = bisect.bisect_right(self._moments, time, key=lambda moment: moment.time)
        if place == 0 or not math.isfinite(time):
            raise ValueError(
                f"the filter remembers from {self._moments[0].time:.3f} s on, it cannot tell of {time!r} s"
            )
        before = self._moments[place - 1]
        state, covariance = before.state.copy(), before.covariance.copy()
        if time > before.time:
            predict(state, covariance, time - before.time, self._noise, self.params.max_step)
        x, y, theta, v, w = state.tolist()
        return Estimate(time, Pose2D(x, y, theta), v, w, 0.5 * (covariance + covariance.T))

    def _follow(self, before: _Moment, after: _Moment) -> None:
        """Predict from one moment to the next and take the measurement of that one in, if it passes."""
        measurement = after.measurement
        assert measurement is not None
        kind, measured, noise = measurement.kind, MEASURED[measurement.kind], measurement.covariance
        state, covariance = before.state.copy(), before.covariance.copy()
        if after.time > before.time:
            predict(state, covariance, after.time - before.time, self._noise, self.params.max_step)
        innovation, spread, length = innovation_of(state, covariance, measured, measurement.values, noise)
        after.state, after.covariance, after.stopped_since = state, covariance, dict(before.stopped_since)
        if length > self._gates[kind]:
            since = after.stopped_since.setdefault(kind, after.time)
            if after.time - since < self.params.patience or after.time == since:
                after.verdict = "gated"
                return
            # As unsure as the surprise is large: the measurement then counts for all that it measures.
            covariance[measured, measured] += innovation**2
            spread[np.diag_indices(len(measured))] += innovation**2
            after.verdict = "recovered"
        else:
            after.verdict = "accepted"
        after.stopped_since.pop(kind, None)
        after.covariance = correct(state, covariance, measured, innovation, spread, noise)

    def _forget(self) -> None:
        """Drop what no measurement can come before any more; the last moment before the horizon stays as a start."""
        oldest = self.time - self.params.horizon
        keep = bisect.bisect_left(self._moments, oldest, key=lambda moment: moment.time) - 1
        for moment in self._moments[: max(keep, 0)]:
            if moment.measurement is not None:
                self._counts[moment.measurement.kind][moment.verdict] += 1
        del self._moments[: max(keep, 0)]


def _require_covariance(covariance: np.ndarray, size: int) -> None:
    """Refuse what is no covariance of `size` values."""
    if covariance.shape == (size, size) and np.abs(covariance - covariance.T).max() <= 1e-9 * np.abs(covariance).max():
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(covariance)
            return
    raise ValueError(
        f"covariance must be symmetric and positive definite, of shape {(size, size)}, got {covariance.tolist()}"
    )
