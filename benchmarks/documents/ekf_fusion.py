"""Experiment of Nguyen et al. (2021): fusion of AMCL, encoders and compass by an EKF on a rectangular route of 78 m."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib
import numpy as np
from matplotlib.figure import Figure as Picture
from scipy.stats import chi2

from lidarnaut.baselines.episode import begin_episode, decide_with
from lidarnaut.baselines.reactive import RouteFollower
from lidarnaut.benchmarks.arena.plots import ERROR, INK, LINES, MUTED
from lidarnaut.benchmarks.documents.figures import Figure, figures_of
from lidarnaut.benchmarks.drives.recording import run_each
from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.localization.ekf import Ekf, Estimate, Measurement
from lidarnaut.envs.localization.fusion import FUSIONS, make_filter, start_covariance
from lidarnaut.envs.logs import rms
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import load_world

PAPER = {
    "position RMSE [mm]": 20.3,
    "greatest x error [mm]": 30.0,
    "greatest y error [mm]": 28.0,
    "heading RMSE [deg]": 0.6939,
    "greatest heading error [deg]": 3.3,
    "mean error across on straights [mm]": 1.6,
    "mean error along on straights [mm]": 20.0,
    "greatest distance [mm]": 30.0,
}
"""Results of Nguyen et al. (2021) with AMCL, encoders and compass: RMSE (equations 11 and 12), maximum errors, and the
errors perpendicular to and along the direction of motion. The greatest distance is at least the greatest error in x."""
ROUTE, TRUE_ROUTE = "to the planned route", "of the true pose to the planned route"
NOTES = (
    f"It is not known which errors the paper means. Rows without '{ROUTE}' have errors of the estimate against ground "
    "truth; rows with it have distances to the pose on the route that was planned for the same time.",
)
RMSES = "position RMSE [mm]", "heading RMSE [deg]"
COMPASS_NOISE = 0.69
"""Standard deviation of the compass in the experiment [deg]: all of the paper's heading error, besides rounding."""
NOISES = (0.1, 0.3, COMPASS_NOISE, 1.15, 2.0)
DISTURBANCES: dict[str, tuple[dict[str, float], Sequence[Sequence[float]]]] = {
    "no disturbance": ({}, ()),
    "hard iron": ({"compass_deviation": math.radians(5.0), "compass_deviation_phase": 0.7}, ()),
    "magnets": ({}, ((12.0, 2.2, 0.26, 2.0), (28.9, 10.0, 0.26, 2.0), (10.0, 20.0, -0.2, 3.0))),
}
"""Disturbances of the compass by name: parameters of the robot's IMU, and magnets of the world."""
DRIVER = "full"
"""Name of the sensor fusion that controls the robot; it uses AMCL, encoders and compass."""
LABELS = {
    "encoder": "encoder alone",
    "amcl": "AMCL alone",
    "encoder_compass": "encoder + compass",
    DRIVER: "full fusion",
}
COLOURS = dict(zip(LABELS, (LINES[1], LINES[2], LINES[3], LINES[0])))
QUICK = {"path": ((4.1, 3.2), (10.1, 3.2)), "map_resolution": 0.05}
"""Arguments of a shortened experiment: only 6 m of the first side of the path."""
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
    straights: np.ndarray
    """Direction of the route, shape (n,), float64 [rad]; NaN in its corners."""
    planned: np.ndarray
    """Poses of the driver's plan on the route (x, y, heading) in the map frame, shape (n, 3), float64 [m, m, rad]."""
    estimated: dict[str, np.ndarray]
    """Estimated poses (x, y, heading) in the map frame, by filter name: shape (n, 3), float64 [m, m, rad]."""
    covariance: dict[str, np.ndarray]
    """Estimated covariances of x, y [m] and heading [rad], by filter name: shape (n, 3, 3), float64."""

    def error(self, name: str, reference: np.ndarray | None = None) -> np.ndarray:
        """Return the pose errors (x, y, heading) of a filter: shape (n, 3), heading in [-180, 180) [mm, mm, deg].

        `name`: of a filter, or `truth`. `reference`: right poses, shape (n, 3); None for ground truth.
        """
        error = self.estimated.get(name, self.truth) - (self.truth if reference is None else reference)
        error[:, 2] = wrap_angle(error[:, 2])
        return error * (1e3, 1e3, math.degrees(1.0))

    def nees(self, name: str) -> np.ndarray:
        """Return the normalised estimation error squared (NEES), shape (n,); 3 on average for a consistent filter."""
        error = self.error(name) / (1e3, 1e3, math.degrees(1.0))
        return np.einsum("ni,ni->n", error, np.linalg.solve(self.covariance[name], error[..., None])[..., 0])

    def measure(self, name: str, reference: np.ndarray | None = None) -> dict[str, float]:
        """Return the quantities of `PAPER`, the RMS error across, and without `reference` the mean NEES.

        Arguments as in `error`.
        """
        error = self.error(name, reference)
        x, y, heading = abs(error).max(axis=0)
        distances, is_straight = np.hypot(error[:, 0], error[:, 1]), ~np.isnan(self.straights)
        c, s = np.cos(self.straights[is_straight]), np.sin(self.straights[is_straight])
        x_error, y_error, _ = error[is_straight].T
        along, across = abs(c * x_error + s * y_error), abs(c * y_error - s * x_error)
        values = rms(distances), x, y, rms(error[:, 2]), heading, across.mean(), along.mean(), distances.max()
        found = {**dict(zip(PAPER, map(float, values))), "RMS error across on straights [mm]": rms(across)}
        return found if reference is not None else {**found, "NEES []": float(self.nees(name).mean())}

    def readings(self, name: str) -> dict[str, float]:
        """Return the measures of a filter; those of the `DRIVER` also by `ROUTE` and `TRUE_ROUTE`."""
        found = {"": self.measure(name)}
        if name == DRIVER:
            found |= {ROUTE: self.measure(name, self.planned), TRUE_ROUTE: self.measure("truth", self.planned)}
        return {_item(key, of): values[key] for key in found[""] for of, values in found.items() if key in values}


def _item(key: str, of: str) -> str:
    return key.replace(" [", f" {of} [") if of else key


def run(pictures: Path, runs: int | None, jobs: int, quick: bool) -> list[Figure]:
    """Repeat the experiment; also with sensor faults, and with noise and disturbances of the compass.

    The compass has a noise of `COMPASS_NOISE`. Errors are against ground truth in the map frame, and against the
    plan of the `RouteFollower`. Straights are the parts of the route with a constant direction, and errors across are
    perpendicular to it.
    """
    seeds, physics = range(1 if quick else runs or 10), ("kinematic", "bullet")[: 1 if quick else 2]
    few, clean, changes = range(min(len(seeds), 3)), "no disturbance", QUICK if quick else {}
    disturbed = [("magnets", COMPASS_NOISE)] if quick else list(itertools.product(DISTURBANCES, NOISES))
    main = [(name, seed, COMPASS_NOISE, clean, changes) for name in physics for seed in seeds]
    others = [("kinematic", seed, noise, name, changes) for name, noise in disturbed for seed in few]
    faulty = [("kinematic", seed, COMPASS_NOISE, clean, changes, True) for seed in few]
    drives = run_each(run_drive, [(*task, False) for task in (*main, *others)] + faulty, jobs, "drives")
    figures = []
    for name, fusion in itertools.product(physics, (DRIVER, "amcl", "encoder_compass", "encoder")):
        some = [drive for drive in drives[: len(main)] if drive.physics == name]
        # The paper has no figures of single sensors, and none of the true pose.
        paper = {_item(key, of): PAPER[key] for key in PAPER for of in ("", ROUTE) if fusion == DRIVER}
        figures += figures_of([drive.readings(fusion) for drive in some], f"{{}}, {LABELS[fusion]}, {name}", paper)
        if fusion == DRIVER:
            done = [float(drive.end_reason == "completed" and drive.collisions == 0) for drive in some]
            figures.append(Figure(f"route completed without contact, {name}", "share", done, best="most"))
            figures.append(Figure(f"NEES within its bounds, {name}", "share", [nees_within(some, fusion)], best="most"))
    for k, (name, noise) in enumerate(disturbed):
        some = drives[len(main) + k * len(few) :][: len(few)]
        for fusion in LABELS:
            of = f"{{}}, compass noise {noise:g} deg, {name}: {LABELS[fusion]}"
            figures += figures_of([{key: drive.measure(fusion)[key] for key in RMSES} for drive in some], of)
    for fault in FAULTS:
        found = [{key: drive.measure(fault)[key] for key in RMSES} for drive in drives[-len(few) :]]
        figures += figures_of(found, f"{{}}, fault: {fault}")
    with matplotlib.rc_context({"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}):
        _draw_drive(drives[0], changes, pictures)
        _draw_errors(drives[: len(main)]).savefig(pictures / "ekf_fusion_errors.png", dpi=70)
    return figures


def make_env(physics: str, map_seed: int, noise: float, disturbance: str, changes: Mapping[str, Any]) -> LidarEnv:
    """Return the environment of the experiment; `noise`: standard deviation of the compass [deg]."""
    (imu, magnets), robot, world = DISTURBANCES[disturbance], load_robot("mpo_500"), load_world("workshop_hall")
    imu = dataclasses.replace(robot.imu, compass_std=math.radians(noise), **imu)
    arguments: dict[str, Any] = {"robot": dataclasses.replace(robot, imu=imu), "start_spread": (0.0, 0.0), **changes}
    if magnets:
        arguments["world"] = dataclasses.replace(world, magnets=np.array(magnets))
    return lidar_env_of(gymnasium.make("lidarnaut/Track-v0", physics=physics, map_seed=map_seed, **arguments))


def run_drive(physics: str, seed: int, noise: float, disturbance: str, changes: Any, has_faults: bool) -> RouteDrive:
    """Simulate a drive along the mapped route, controlled by the fused pose; return true and estimated poses.

    Each of the `FILTERS`, or `FAULTS`, processes the same measurements with its own fault (delay, loss or error).
    """
    env, filters = make_env(physics, seed, noise, disturbance, changes), FAULTS if has_faults else FILTERS
    follower = RouteFollower()
    observation, info = begin_episode(env, follower, seed, np.random.default_rng([seed, 1]))
    decide, fused, route = decide_with(follower, env), env.robots[0].estimator, env.task.route
    channels = {}
    for k, (name, fault) in enumerate(filters.items()):
        ekf = make_filter(env.robot_params, env.task.control_period)
        ekf.reset(fused.pivot, start_covariance())
        channels[name] = FaultyChannel(ekf, fault, np.random.default_rng([seed, k]))
    rows: list[tuple[float, Pose2D, Pose2D]] = []
    estimates: dict[str, list[Estimate]] = {name: [] for name in ("amcl", *filters)}
    while "end_reason" not in info:
        observation, _, _, _, info = env.step(decide(observation))
        rows.append((info["time"], env.map_pose.between(env.truths[0].state.pose), route.at(follower.along)))
        estimates["amcl"].append(fused.localized)
        for name, channel in channels.items():
            estimate = channel.deliver(info["time"], fused.measurements)
            estimates[name].append(dataclasses.replace(estimate, pose=estimate.pose.compose(fused.pivot.inverse())))
    env.close()
    time, truth, planned = zip(*rows)
    nearest = [int(np.argmin(np.hypot(*(route.points - pose[:2]).T))) for pose in truth]
    is_straight = abs(np.gradient(np.unwrap(route.headings)))[nearest] < 1e-6
    return RouteDrive(
        physics=env.task.physics,
        seed=seed,
        end_reason=info["end_reason"],
        collisions=info["collisions"],
        time=np.array(time),
        truth=np.array(truth),
        straights=np.where(is_straight, route.headings[nearest], np.nan),
        planned=np.array(planned),
        estimated={name: np.array([one.pose for one in many]) for name, many in estimates.items()},
        covariance={name: np.array([one.covariance[:3, :3] for one in many]) for name, many in estimates.items()},
    )


def nees_within(drives: Sequence[RouteDrive], name: str) -> float:
    """Return the share of periods whose NEES, averaged over drives, lies in the 95 % bounds of a consistent filter."""
    low, high = chi2.ppf([0.025, 0.975], 3 * len(drives)) / len(drives)
    steps = min(len(drive.time) for drive in drives)
    mean = np.mean([drive.nees(name)[:steps] for drive in drives], axis=0)
    return float(np.mean((low <= mean) & (mean <= high)))


def _draw_drive(drive: RouteDrive, changes: Mapping[str, Any], folder: Path) -> None:
    env = make_env(drive.physics, drive.seed, COMPASS_NOISE, "no disturbance", changes)
    what = f"{drive.physics} physics, seed {drive.seed}"
    env.reset(seed=drive.seed)
    grid = env.belief.grid
    env.close()
    position, heading = (Picture(figsize=(10, height), layout="constrained") for height in (7.4, 3.6))
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
    position.savefig(folder / "ekf_fusion_position.png", dpi=85)
    heading.savefig(folder / "ekf_fusion_heading.png", dpi=110)


def _draw_errors(drives: Sequence[RouteDrive]) -> Picture:
    physics = list(dict.fromkeys(drive.physics for drive in drives))
    figure = Picture(figsize=(5.2 * len(physics), 7.4), layout="constrained")
    grid = figure.subplots(3, len(physics), sharex="col", sharey="row", squeeze=False)
    greatest, mean = "maximum error of the paper", "RMSE of the paper (maximum 3.3)"
    labels = "x error [mm]", "y error [mm]", "heading error [deg]"
    _, x, y, heading, *_ = PAPER.values()
    bounds = (x, greatest), (y, greatest), (heading, mean)
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
