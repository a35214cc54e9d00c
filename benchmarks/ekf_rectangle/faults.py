"""What the fusion survives: the same drives with measurements late, missing, wrong, or without one of the sensors."""

import dataclasses
from collections import Counter
from collections.abc import Callable

import numpy as np
import tyro

from baselines.route_follower import RouteFollower
from envs.geometry import Pose2D, wrap_angle
from envs.localization.ekf import Ekf, Measurement
from envs.localization.fusion import make_filter, start_covariance

from .drive import make_env

Delivery = tuple[float, Measurement]
"""How much later than it should a measurement comes [s], and the measurement."""
Fault = Callable[[Measurement, np.random.Generator], list[Delivery]]


def _without(kind: str) -> Fault:
    return lambda measurement, rng: [] if measurement.kind == kind else [(0.0, measurement)]


def _late(measurement: Measurement, rng: np.random.Generator) -> list[Delivery]:
    return [(rng.uniform(0.0, 0.8), measurement)]


def _too_late(measurement: Measurement, rng: np.random.Generator) -> list[Delivery]:
    return [(3.0 if rng.random() < 0.1 else 0.0, measurement)]


def _missing(measurement: Measurement, rng: np.random.Generator) -> list[Delivery]:
    return [(0.0, measurement)] if rng.random() < 0.5 else []


def _silent(measurement: Measurement, rng: np.random.Generator) -> list[Delivery]:
    return [] if 40.0 < measurement.time < 45.0 else [(0.0, measurement)]


def _wrong(measurement: Measurement, rng: np.random.Generator) -> list[Delivery]:
    if rng.random() < 0.05:
        off = 3.0 * rng.standard_normal(len(measurement.values))
        measurement = dataclasses.replace(measurement, values=measurement.values + off)
    return [(0.0, measurement)]


FAULTS: dict[str, Fault] = {
    "none": lambda measurement, rng: [(0.0, measurement)],
    "each up to 0.8 s late, out of order": _late,
    "one in ten 3 s late": _too_late,
    "half of all missing": _missing,
    "all silent for 5 s": _silent,
    "one in twenty wrong by metres": _wrong,
    "no compass": _without("compass"),
    "no map": _without("map"),
    "no encoders": _without("encoder"),
}
"""What goes wrong with measurements, by name."""


class FaultyLine:
    """A filter behind a line on which something goes wrong."""

    def __init__(self, ekf: Ekf, fault: Fault, rng: np.random.Generator) -> None:
        self.ekf = ekf
        self.ekf.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
        self._fault = fault
        self._rng = rng
        self._waiting: list[Delivery] = []
        self.errors: list[tuple[float, float]] = []

    def pass_on(self, time: float, measurements: list[Measurement]) -> None:
        """Hand measurements to the filter, now or later."""
        for measurement in measurements:
            self._waiting += [(time + delay, late) for delay, late in self._fault(measurement, self._rng)]
        due = [delivery for delivery in self._waiting if delivery[0] <= time]
        self._waiting = [delivery for delivery in self._waiting if delivery[0] > time]
        for _, measurement in sorted(due, key=lambda delivery: delivery[0]):
            self.ekf.add(measurement)

    def compare(self, time: float, truth: Pose2D) -> None:
        """Note by how much the filter errs."""
        # Nothing is known later than what came last: a silent filter is asked for its prediction.
        error = self.ekf.estimate(max(time, self.ekf.time)).pose.between(truth)
        self.errors.append((float(np.hypot(error.x, error.y)), abs(float(wrap_angle(error.theta)))))


def run_faults(physics: str, seed: int) -> dict[str, FaultyLine]:
    """Drive once; every filter hears of the same drive what its line lets pass."""
    env = make_env(physics, map_seed=seed)
    observation, _ = env.reset(seed=seed)
    tracker = RouteFollower()
    tracker.reset(env.robot, env.control_period, env.route)
    lines = {
        name: FaultyLine(make_filter(env.robot), fault, np.random.default_rng([seed, k]))
        for k, (name, fault) in enumerate(FAULTS.items())
    }
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(tracker.act(observation, env.estimate.pose))
        ended = terminated or truncated
        for line in lines.values():
            line.pass_on(info["time"], env.fused.measurements)
            line.compare(info["time"], env.true_pose)
    env.close()
    return lines


def main(seeds: int = 3, physics: str = "kinematic") -> None:
    """Print errors and what became of the measurements, for each fault.

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
    tyro.cli(main)
