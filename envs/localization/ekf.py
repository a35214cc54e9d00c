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
from typing import Literal

import numpy as np
from scipy.stats import chi2

from envs.geometry import Pose2D, wrap_angle

from .ekf_kernels import STATE_SIZE, correct, innovation_of, predict
from .measurements import KINDS, MEASURED, Measurement

Verdict = Literal["accepted", "recovered", "gated", "too_old", "unusable"]
"""Outcome of a measurement; see `EkfParams`."""


@dataclass(frozen=True, slots=True)
class EkfParams:
    """Process noise and innovation gating."""

    acceleration: float = 0.3
    """Root of the spectral density of forward acceleration [m/s2/sqrt(Hz)]: the speed's deviation after 1 s."""
    angular_acceleration: float = 0.6
    """Root of the spectral density of angular acceleration [rad/s2/sqrt(Hz)]."""
    position_drift: float = 0.001
    """Standard deviation of the position after 1 s from sources other than the speed, along either axis [m]."""
    heading_drift: float = 0.0005
    """Standard deviation of the heading after 1 s from sources other than the yaw rate [rad]."""
    max_step: float = 0.002
    """Longest step of the prediction [s]."""
    horizon: float = 1.0
    """How late a measurement may arrive [s]. Later ones are rejected, and counted as `too_old`."""
    gate: float = 0.999
    """Share of true measurements that pass the chi-square gate; rejected ones are counted as `gated`."""
    patience: float = 2.0
    """Once all measurements of a kind have been gated for this long [s], the filter counts as diverged: it
    inflates the covariance of what that kind measures and accepts the next one, which is counted as `recovered`."""

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

    def __init__(self, params: EkfParams = EkfParams()) -> None:
        """Build a filter at the origin at time 0, with variances of one in SI units; see `reset`."""
        self.params = params
        drift, turn = params.position_drift, params.heading_drift
        self._noise = np.square([drift, drift, turn, params.acceleration, params.angular_acceleration])
        self._gates = {kind: float(chi2.ppf(params.gate, len(MEASURED[kind]))) for kind in KINDS}
        self.reset(Pose2D(0.0, 0.0, 0.0), np.eye(STATE_SIZE))

    def reset(self, pose: Pose2D, covariance: np.ndarray, *, v: float = 0.0, w: float = 0.0, time: float = 0.0) -> None:
        """Start anew at a time [s]; also necessary after the clock was set back.

        For pose, speed, yaw rate and covariance see `Estimate`.

        Raises:
            ValueError: something is not finite, or the covariance is not symmetric and positive definite.
        """
        state = np.array([pose.x, pose.y, float(wrap_angle(pose.theta)), v, w])
        if not (np.isfinite(state).all() and math.isfinite(time)):
            raise ValueError(f"pose, v, w and time must be finite, got {tuple(pose)}, {v!r}, {w!r}, {time!r}")
        covariance = np.array(covariance, dtype=np.float64)
        _require_covariance(covariance, STATE_SIZE)
        self._moments = [_Moment(time, None, "accepted", state, covariance)]
        self._counts: Counter[tuple[str, Verdict]] = Counter()

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
        if measurement.time < max(self._moments[0].time, self.time - self.params.horizon):
            self._counts[measurement.kind, "too_old"] += 1
            return "too_old"
        added = _Moment(measurement.time, measurement)
        index = bisect.bisect_right(self._moments, added.order, key=lambda moment: moment.order)
        self._moments.insert(index, added)
        for k in range(index, len(self._moments)):
            self._apply(self._moments[k - 1], self._moments[k])
        self._prune()
        return added.verdict

    def estimate(self, time: float | None = None) -> Estimate:
        """Return the estimate at a time [s], by default that of the newest measurement.

        Later times are predicted; for earlier ones only measurements until then count.

        Raises:
            ValueError: the filter does not remember the time any more.
        """
        time = self.time if time is None else time
        index = bisect.bisect_right(self._moments, time, key=lambda moment: moment.time)
        if index == 0 or not math.isfinite(time):
            raise ValueError(f"the filter remembers from {self._moments[0].time:.3f} s on, got {time!r} s")
        state, covariance = self._predict(self._moments[index - 1], time)
        x, y, theta, v, w = state.tolist()
        return Estimate(time, Pose2D(x, y, theta), v, w, 0.5 * (covariance + covariance.T))

    def _predict(self, before: _Moment, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return state and covariance at a time [s] that is not before a moment."""
        state, covariance = before.state.copy(), before.covariance.copy()
        if time > before.time:
            predict(state, covariance, time - before.time, self._noise, self.params.max_step)
        return state, covariance

    def _apply(self, before: _Moment, after: _Moment) -> None:
        """Predict from one moment to the next, and update by the measurement of that one if it passes the gate."""
        measurement = after.measurement
        assert measurement is not None
        kind, measured, noise = measurement.kind, MEASURED[measurement.kind], measurement.covariance
        state, covariance = self._predict(before, after.time)
        innovation, spread, length = innovation_of(state, covariance, measured, measurement.values, noise)
        after.state, after.covariance, after.gated_since = state, covariance, dict(before.gated_since)
        if length > self._gates[kind]:
            since = after.gated_since.setdefault(kind, after.time)
            if after.time - since < self.params.patience or after.time == since:
                after.verdict = "gated"
                return
            # With a prior as uncertain as the innovation is large, the measurement decides.
            covariance[measured, measured] += innovation**2
            spread[np.diag_indices(len(measured))] += innovation**2
            after.verdict = "recovered"
        else:
            after.verdict = "accepted"
        after.gated_since.pop(kind, None)
        after.covariance = correct(state, covariance, measured, innovation, spread, noise)

    def _prune(self) -> None:
        """Drop moments before the horizon but for the last one, from which late measurements are predicted."""
        oldest = self.time - self.params.horizon
        keep = max(bisect.bisect_left(self._moments, oldest, key=lambda moment: moment.time) - 1, 0)
        self._counts.update(_tally(self._moments[:keep]))
        del self._moments[:keep]


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
