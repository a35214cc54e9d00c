"""Robustness of the fusion: drives with late, missing or wrong measurements, or without one of the sensors."""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from envs.command_line import Count, run_command
from envs.geometry import Pose2D, wrap_angle
from envs.localization.ekf import Ekf, Measurement

from .drive import follow_route, make_env, make_started_filter, true_pose

Delivery = tuple[float, Measurement]
"""Delay [s], infinite for a measurement that is lost, and the measurement."""
Fault = Callable[[Measurement, np.random.Generator], Delivery]


def _wrong(measurement: Measurement, rng: np.random.Generator) -> Delivery:
    if rng.random() < 0.05:
        off = 3.0 * rng.standard_normal(len(measurement.values))
        measurement = dataclasses.replace(measurement, values=measurement.values + off)
    return 0.0, measurement


def _lost_if(is_lost: Callable[[Measurement, np.random.Generator], bool]) -> Fault:
    return lambda sent, rng: (math.inf if is_lost(sent, rng) else 0.0, sent)


FAULTS: dict[str, Fault] = {
    "none": lambda sent, rng: (0.0, sent),
    "each up to 0.8 s late, out of order": lambda sent, rng: (rng.uniform(0.0, 0.8), sent),
    "one in ten 3 s late": lambda sent, rng: (3.0 if rng.random() < 0.1 else 0.0, sent),
    "half of all missing": _lost_if(lambda sent, rng: rng.random() >= 0.5),
    "all silent for 5 s": _lost_if(lambda sent, rng: 40.0 < sent.time < 45.0),
    "one in twenty wrong by metres": _wrong,
    "no compass": _lost_if(lambda sent, rng: sent.kind == "compass"),
    "no map": _lost_if(lambda sent, rng: sent.kind == "map"),
    "no encoders": _lost_if(lambda sent, rng: sent.kind == "encoder"),
}
"""Faults by name."""


class FaultyChannel:
    """A filter whose measurements pass through a channel with a fault."""

    def __init__(self, ekf: Ekf, fault: Fault, rng: np.random.Generator) -> None:
        self.ekf = ekf
        self.errors: list[tuple[float, float]] = []
        """Errors of position [m] and heading [rad], one for each call of `compare`."""
        self._fault = fault
        self._rng = rng
        self._delayed: list[Delivery] = []

    def deliver(self, time: float, measurements: list[Measurement]) -> None:
        """Give measurements to the filter, now or later."""
        for measurement in measurements:
            delay, sent = self._fault(measurement, self._rng)
            if delay < math.inf:
                self._delayed.append((time + delay, sent))
        due = [delivery for delivery in self._delayed if delivery[0] <= time]
        self._delayed = [delivery for delivery in self._delayed if delivery[0] > time]
        for _, measurement in sorted(due, key=lambda delivery: delivery[0]):
            self.ekf.add(measurement)

    def compare(self, time: float, truth: Pose2D) -> None:
        """Record the filter's error, that of its prediction if there were no measurements."""
        error = self.ekf.estimate(max(time, self.ekf.time)).pose.between(truth)
        self.errors.append((float(np.hypot(error.x, error.y)), abs(float(wrap_angle(error.theta)))))


def run_faults(physics: str, seed: int) -> dict[str, FaultyChannel]:
    """Drive once, with a filter for each fault."""
    env = make_env(physics, map_seed=seed)
    channels = {
        name: FaultyChannel(make_started_filter(env), fault, np.random.default_rng([seed, k]))
        for k, (name, fault) in enumerate(FAULTS.items())
    }
    for info in follow_route(env, seed):
        for channel in channels.values():
            channel.deliver(info["time"], env.robots[0].estimator.measurements)
            channel.compare(info["time"], true_pose(env))
    return channels


def main(seeds: Count = 3, physics: str = "kinematic") -> None:
    """Print errors and verdicts of the measurements, for each fault.

    Args:
        seeds: drives.
        physics: "kinematic" or "bullet".
    """
    drives = [run_faults(physics, seed) for seed in range(seeds)]
    print(f"{physics} physics, {seeds} drives: root mean square (greatest) error, share of measurements")
    print(f"{'fault':37} {'position [mm]':>15} {'heading [deg]':>15}  accepted   gated  too old  recovered")
    for name in FAULTS:
        errors = np.concatenate([drive[name].errors for drive in drives]) * (1e3, 180.0 / np.pi)
        rms, greatest = np.sqrt(np.mean(errors**2, axis=0)), errors.max(axis=0)
        verdicts: Counter[str] = Counter()
        for drive in drives:
            for counts in drive[name].ekf.counts.values():
                verdicts.update(counts)
        shares = [100.0 * verdicts[key] / verdicts.total() for key in ("accepted", "gated", "too_old", "recovered")]
        print(
            f"{name:37} {rms[0]:7.1f} ({greatest[0]:5.0f}) {rms[1]:7.3f} ({greatest[1]:4.2f})  "
            + " ".join(f"{share:6.1f} %" for share in shares)
        )


if __name__ == "__main__":
    run_command(main)
