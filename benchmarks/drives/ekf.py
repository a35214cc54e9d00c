"""Benchmark of EKF pose fusion on the 78 m rectangular route of Nguyen et al. (2021); see `docs/notes/ekf.md`."""

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import gymnasium
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from lidarnaut.baselines.episode import begin_episode, decide_with
from lidarnaut.baselines.reactive import RouteFollower
from lidarnaut.benchmarks.arena.plots import ERROR, INK, LINES, MUTED
from lidarnaut.benchmarks.drives.recording import Row, run_each
from lidarnaut.envs.command_line import Count
from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.localization.ekf import Ekf, Estimate, Measurement
from lidarnaut.envs.localization.fusion import FUSIONS, make_filter, start_covariance
from lidarnaut.envs.logs import rms
from lidarnaut.envs.navigation import crop_to_known

PAPER = {
    "position_rmse_mm": 20.3,
    "max_x_mm": 30.0,
    "max_y_mm": 28.0,
    "heading_rmse_deg": 0.6939,
    "max_heading_deg": 3.3,
}
"""Results of Nguyen et al. (2021) with AMCL, encoders and compass: RMSE (equations 11 and 12) and maximum errors."""
DRIVER = "full"
"""Name of the sensor fusion that controls the robot; it uses AMCL, encoders and compass."""
LABELS = {
    "encoder": "encoder alone",
    "amcl": "AMCL alone",
    "encoder_compass": "encoder + compass",
    DRIVER: "full fusion",
}
COLOURS = dict(zip(LABELS, (LINES[1], LINES[2], LINES[3], LINES[0])))
Physics = Literal["kinematic", "bullet"]
Delivery = tuple[float, Measurement]
"""Measurement on its way to the filter: delay [s], inf if lost, and the measurement."""
Fault = Callable[[Measurement, np.random.Generator], Delivery]


def _lost_if(is_lost: Callable[[Measurement, np.random.Generator], bool]) -> Fault:
    return lambda sent, rng: (math.inf if is_lost(sent, rng) else 0.0, sent)


def _wrong(measurement: Measurement, rng: np.random.Generator) -> Delivery:
    if rng.random() < 0.05:
        off = 3.0 * rng.standard_normal(len(measurement.values))
        measurement = dataclasses.replace(measurement, values=measurement.values + off)
    return 0.0, measurement


FILTERS: dict[str, Fault] = {
    name: _lost_if(lambda sent, rng, kinds=kinds: sent.kind not in kinds) for name, kinds in FUSIONS.items() if kinds
}
"""Compared sensor sets by name: functions that drop the measurements of all other sensors."""
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
"""Simulated faults by name, as functions that delay, drop or corrupt measurements."""


class FaultyChannel:
    """Faulty connection to an EKF: measurements arrive late, wrong or never."""

    def __init__(self, ekf: Ekf, fault: Fault, rng: np.random.Generator) -> None:
        self.ekf, self._fault, self._rng = ekf, fault, rng
        self._delayed: list[Delivery] = []

    def deliver(self, time: float, measurements: Sequence[Measurement]) -> Estimate:
        """Send measurements to the EKF with simulated faults; return its pose estimate at `time` [s]."""
        for measurement in measurements:
            delay, sent = self._fault(measurement, self._rng)
            if delay < math.inf:
                self._delayed.append((time + delay, sent))
        due = [delivery for delivery in self._delayed if delivery[0] <= time]
        self._delayed = [delivery for delivery in self._delayed if delivery[0] > time]
        for _, measurement in sorted(due, key=lambda delivery: delivery[0]):
            self.ekf.add(measurement)
        return self.ekf.estimate(max(time, self.ekf.time))


@dataclass(frozen=True, slots=True, eq=False)
class RouteDrive:
    """Recorded drive along a route, with n control periods."""

    physics: str
    seed: int
    """Seed of this drive, and of the earlier drive that mapped the route."""
    end_reason: str
    collisions: int
    time: np.ndarray
    """Simulated time, shape (n,), float64 [s]."""
    truth: np.ndarray
    """True poses (x, y, heading) in the map frame, shape (n, 3), float64 [m, m, rad]."""
    estimated: dict[str, np.ndarray]
    """Estimated poses (x, y, heading) in the map frame, by filter name: shape (n, 3), float64 [m, m, rad]."""
    covariance: dict[str, np.ndarray]
    """Estimated covariances of x, y [m] and heading [rad], by filter name: shape (n, 3, 3), float64."""
    verdicts: dict[str, Counter[str]]
    """Number of measurements by filter name and decision: `accepted`, `gated` (rejected as outlier), `too_old`, ..."""

    def error(self, name: str) -> np.ndarray:
        """Return the pose errors (x, y, heading) of a filter: shape (n, 3), heading in [-180, 180) [mm, mm, deg]."""
        error = self.estimated[name] - self.truth
        error[:, 2] = wrap_angle(error[:, 2])
        return error * (1e3, 1e3, math.degrees(1.0))

    def nees(self, name: str) -> np.ndarray:
        """Return the normalised estimation error squared (NEES), shape (n,); 3 on average for a consistent filter."""
        error = self.error(name) / (1e3, 1e3, math.degrees(1.0))
        return np.einsum("ni,ni->n", error, np.linalg.solve(self.covariance[name], error[..., None])[..., 0])


def compare_fusions(
    seeds: Count = 20,
    jobs: Count = 2,
    physics: tuple[Physics, ...] = ("kinematic", "bullet"),
    images: Path = Path("docs/images"),
) -> list[Row]:
    """Measure EKF fusion of AMCL, encoders and compass on the route of Nguyen et al. (2021).

    The table has median and maximum errors over drives.

    Args:
        seeds: number of drives per simulator, each with its own noise and map.
        jobs: number of processes.
        physics: simulators.
        images: output folder for figures 5 to 10 of the paper, `ekf_*.png`.
    """
    drives = run_each(run_drive, list(itertools.product(physics, range(seeds))), jobs, "drives")
    rows = []
    for name, fusion in itertools.product(physics, LABELS):
        some = [drive for drive in drives if drive.physics == name]
        rows.append({"fusion": LABELS[fusion], "physics": name, **measure(some, fusion)})
        if fusion == DRIVER:
            completed = sum(drive.end_reason == "completed" for drive in some)
            rows[-1] |= {"completed": completed, "collisions": sum(drive.collisions for drive in some)}
    images.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}):
        _draw_drive(drives[0], images)
        _draw_errors(drives).savefig(images / "ekf_errors.png", dpi=110)
    return [*rows, {"fusion": "the paper", **PAPER}]


def compare_faults(seeds: Count = 3, physics: Physics = "kinematic") -> list[Row]:
    """Measure EKF fusion with late, missing or wrong measurements: errors and shares of accepted measurements.

    Args:
        seeds: number of drives.
        physics: simulator.
    """
    drives, rows = [run_drive(physics, seed, FAULTS) for seed in range(seeds)], []
    for name in FAULTS:
        errors = np.concatenate([drive.error(name) for drive in drives])
        position, heading = np.hypot(errors[:, 0], errors[:, 1]), abs(errors[:, 2])
        row: Row = {"fault": name, "position_rms_mm": rms(position), "position_max_mm": float(position.max())}
        row |= {"heading_rms_deg": rms(heading), "heading_max_deg": float(heading.max())}
        verdicts = sum((drive.verdicts[name] for drive in drives), Counter[str]())
        shares = ("accepted", "gated", "too_old", "recovered")
        rows.append(row | {key: verdicts[key] / verdicts.total() for key in shares})
    return rows


def make_env(physics: str, map_seed: int) -> LidarEnv:
    arguments = {"physics": physics, "map_seed": map_seed, "fusion": DRIVER, "start_spread": (0.0, 0.0)}
    return lidar_env_of(gymnasium.make("lidarnaut/Track-v0", **arguments))


def run_drive(
    physics: str, seed: int, filters: Mapping[str, Fault] = FILTERS, max_steps: int | None = None
) -> RouteDrive:
    """Simulate a drive along the mapped route, controlled by the fused pose; return true and estimated poses.

    Each of the `filters` processes the same measurements with its own fault (delay, loss or error).
    """
    env, follower = make_env(physics, map_seed=seed), RouteFollower()
    observation, info = begin_episode(env, follower, seed, np.random.default_rng([seed, 1]))
    decide, fused = decide_with(follower, env), env.robots[0].estimator
    channels = {}
    for k, (name, fault) in enumerate(filters.items()):
        ekf = make_filter(env.robot)
        ekf.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
        channels[name] = FaultyChannel(ekf, fault, np.random.default_rng([seed, k]))
    rows: list[tuple[float, Pose2D]] = []
    estimates: dict[str, list[Estimate]] = {name: [] for name in ("amcl", *filters)}
    while "end_reason" not in info and len(rows) != max_steps:
        observation, _, _, _, info = env.step(decide(observation))
        rows.append((info["time"], env.map_pose.between(env.truths[0].state.pose)))
        estimates["amcl"].append(fused.localized)
        for name, channel in channels.items():
            estimates[name].append(channel.deliver(info["time"], fused.measurements))
    env.close()
    time, truth = zip(*rows)
    return RouteDrive(
        physics=physics,
        seed=seed,
        end_reason=info.get("end_reason", "max_steps"),
        collisions=info["collisions"],
        time=np.array(time),
        truth=np.array(truth),
        estimated={name: np.array([one.pose for one in many]) for name, many in estimates.items()},
        covariance={name: np.array([one.covariance[:3, :3] for one in many]) for name, many in estimates.items()},
        verdicts={
            name: sum(map(Counter, channel.ekf.counts.values()), Counter()) for name, channel in channels.items()
        },
    )


def nees_bounds(num_drives: int) -> tuple[float, float]:
    """Return the 95 % bounds of a consistent filter's normalised estimation error squared, averaged over drives."""
    low, high = chi2.ppf([0.025, 0.975], 3 * num_drives) / num_drives
    return float(low), float(high)


def measure(drives: Sequence[RouteDrive], fusion: str) -> Row:
    """Return a filter's pose errors: medians over drives, and maxima with the suffix `_worst`.

    `nees` is the mean normalised estimation error squared, 3 for a consistent filter. `nees_within` is the share of
    control periods whose NEES, averaged over drives, lies within its 95 % bounds.
    """
    found = []
    for error in (drive.error(fusion) for drive in drives):
        x, y, heading = abs(error).max(axis=0)
        found.append((rms(np.hypot(error[:, 0], error[:, 1])), x, y, rms(error[:, 2]), heading))
    row: Row = {}
    for key, middle, worst in zip(PAPER, np.median(found, axis=0).tolist(), np.max(found, axis=0).tolist()):
        row |= {key: middle, f"{key}_worst": worst}
    steps, (low, high) = min(len(drive.time) for drive in drives), nees_bounds(len(drives))
    nees = np.array([drive.nees(fusion)[:steps] for drive in drives])
    mean = nees.mean(axis=0)
    return row | {"nees": float(nees.mean()), "nees_within": float(np.mean((low <= mean) & (mean <= high)))}


def _draw_drive(drive: RouteDrive, folder: Path) -> None:
    env, what = make_env(drive.physics, map_seed=drive.seed), f"{drive.physics} physics, seed {drive.seed}"
    env.reset(seed=drive.seed)
    grid = crop_to_known(env.belief.grid)
    env.close()
    position, heading = (Figure(figsize=(10, height), layout="constrained") for height in (7.4, 3.6))
    path, turns = position.subplots(), heading.subplots()
    x_min, y_min, x_max, y_max = grid.bounds
    shades, extent = np.where(grid.data < 0, 0.82, 1.0 - grid.data / 100.0), (x_min, x_max, y_min, y_max)
    path.imshow(shades, cmap="gray", origin="lower", extent=extent, vmin=0, vmax=1, interpolation="antialiased")
    lines = [(drive.estimated[fusion], label, COLOURS[fusion], {}) for fusion, label in LABELS.items()]
    for poses, label, color, dashes in [*lines, (drive.truth, "truth", INK, {"lw": 0.8, "ls": "--"})]:
        path.plot(*poses[:, :2].T, color=color, label=label, **{"lw": 1.6, **dashes})
        turns.plot(drive.time, np.degrees(np.unwrap(poses[:, 2])), color=color, label=label, **dashes)
    path.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    path.set_title(f"Position on the prior map ({what}); figures 5 and 6 of the paper")
    turns.set(xlabel="time [s]", ylabel="heading [deg]", yticks=range(0, 361, 90))
    turns.set_title(f"Heading ({what}); figure 7 of the paper")
    position.legend(loc="outside lower center", ncols=5, frameon=False)
    turns.legend(frameon=False)
    position.savefig(folder / "ekf_position.png", dpi=110)
    heading.savefig(folder / "ekf_heading.png", dpi=110)


def _draw_errors(drives: Sequence[RouteDrive]) -> Figure:
    physics = list(dict.fromkeys(drive.physics for drive in drives))
    figure = Figure(figsize=(5.2 * len(physics), 7.4), layout="constrained")
    grid = figure.subplots(3, len(physics), sharex="col", sharey="row", squeeze=False)
    greatest, mean = "maximum error of the paper", "RMSE of the paper (maximum 3.3)"
    labels = "x error [mm]", "y error [mm]", "heading error [deg]"
    bounds = (PAPER["max_x_mm"], greatest), (PAPER["max_y_mm"], greatest), (PAPER["heading_rmse_deg"], mean)
    for (k, label), name in itertools.product(enumerate(labels), physics):
        axes, some = grid[k, physics.index(name)], [drive for drive in drives if drive.physics == name]
        for fusion in ("amcl", DRIVER):
            for drive in some:
                axes.plot(drive.time, drive.error(fusion)[:, k], color=COLOURS[fusion], lw=0.7, alpha=0.3)
            axes.plot([], [], color=COLOURS[fusion], label=LABELS[fusion])
        axes.axhline(bounds[k][0], color=ERROR, lw=1.0, ls=":", label=bounds[k][1])
        axes.axhline(-bounds[k][0], color=ERROR, lw=1.0, ls=":")
        axes.axhline(0.0, color=MUTED, lw=0.6)
        grid[k, 0].set_ylabel(label)
        grid[0, physics.index(name)].set_title(f"{name} physics, drives: {len(some)}")
        grid[-1, physics.index(name)].set_xlabel("time [s]")
    for axes in grid[:, -1]:
        axes.legend(loc="upper right", fontsize=7, framealpha=0.8)
    figure.suptitle("Errors of AMCL alone and of the full fusion; figures 8 to 10 of the paper")
    return figure
