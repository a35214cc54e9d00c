"""Drives around the rectangle with the estimates of all fusions, their measures, and the paper's results."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from scipy.stats import chi2

import envs  # noqa: F401  (registers the environments)
from baselines.episode import begin_episode, decide_with
from baselines.route_follower import RouteFollower
from benchmarks.parallel import run_each
from envs.core import LidarEnv, lidar_env_of
from envs.geometry import Pose2D, wrap_angle
from envs.localization.ekf import Ekf, Estimate
from envs.localization.fusion import FUSIONS, make_filter, start_covariance
from envs.logs import rms

PAPER = {
    "position_rmse": 0.0203,
    "heading_rmse": 0.6939,
    "max_x": 0.03,
    "max_y": 0.028,
    "max_heading": 3.3,
}
"""Results of Nguyen et al. (2021) for the full fusion: errors of the position [m] and of the heading [deg], root mean
square (equations 11 and 12) and greatest."""
DRIVER = "full"
"""Fusion by which the robot drives. The others run along on the same measurements."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Record of a drive: poses in the map frame, after each control period."""

    physics: str
    seed: int
    """Seed of the drive, and of the one that made its map."""
    end_reason: str
    """Why it ended; see `FollowRoute`."""
    collisions: int
    time: np.ndarray
    """Shape (n,), float64 [s]."""
    truth: np.ndarray
    """Shape (n, 3), float64: x, y, heading [m, m, rad]."""
    deviation: np.ndarray
    """Shape (n,), float64: signed distance from the route, positive to its left [m]."""
    estimated: dict[str, np.ndarray]
    """By fusion: estimated poses, as `truth`."""
    covariance: dict[str, np.ndarray]
    """By fusion: shape (n, 3, 3), float64, of x, y and heading."""
    counts: dict[str, dict[str, int]]
    """Measurements of the full fusion: kind, verdict, number."""

    def error(self, fusion: str) -> np.ndarray:
        """Return estimated minus true poses, shape (n, 3), headings wrapped to [-pi, pi) [m, m, rad]."""
        error = self.estimated[fusion] - self.truth
        error[:, 2] = wrap_angle(error[:, 2])
        return error

    def nees(self, fusion: str) -> np.ndarray:
        """Return the normalised estimation error squared (NEES), shape (n,); 3 on average for a consistent filter."""
        error = self.error(fusion)
        return np.einsum("ni,ni->n", error, np.linalg.solve(self.covariance[fusion], error[..., None])[..., 0])


def make_env(physics: str, map_seed: int) -> LidarEnv:
    """Return the environment of the experiment, in which the robot knows its initial pose."""
    env = gymnasium.make(
        "lidarnaut/Track-v0", physics=physics, map_seed=map_seed, fusion=DRIVER, start_spread=(0.0, 0.0)
    )
    return lidar_env_of(env)


def true_pose(env: LidarEnv) -> Pose2D:
    """Return the true pose of the robot, map frame."""
    return env.map_pose.between(env.truths[0].state.pose)


def make_started_filter(env: LidarEnv) -> Ekf:
    """Return a filter in the initial state of that by which the robot drives."""
    ekf = make_filter(env.robot)
    ekf.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
    return ekf


def follow_route(env: LidarEnv, seed: int) -> Iterator[dict[str, Any]]:
    """Drive a route to its end by the fused pose; yield `info` after each control period. Closes the environment."""
    follower = RouteFollower()
    observation, _ = begin_episode(env, follower, seed, np.random.default_rng([seed, 1]))
    decide, ended = decide_with(follower, env), False
    try:
        while not ended:
            observation, _, terminated, truncated, info = env.step(decide(observation))
            ended = terminated or truncated
            yield info
    finally:
        env.close()


def run_drive(physics: str, seed: int, max_steps: int | None = None) -> Drive:
    """Map the route, then drive it with the same seed, for so many control periods; None drives to the end."""
    env = make_env(physics, map_seed=seed)
    filters = {name: make_started_filter(env) for name, kinds in FUSIONS.items() if kinds and name != DRIVER}
    rows: list[tuple[float, float, Pose2D]] = []
    estimates: dict[str, list[Estimate]] = {name: [] for name in FUSIONS}
    for info in itertools.islice(follow_route(env, seed), max_steps):
        rows.append((info["time"], info["deviation"], true_pose(env)))
        estimates[DRIVER].append(env.robots[0].estimator.estimate)
        estimates["amcl"].append(env.robots[0].estimator.localized)
        for name, ekf in filters.items():
            for measurement in env.robots[0].estimator.measurements:
                if measurement.kind in FUSIONS[name]:
                    ekf.add(measurement)
            estimates[name].append(ekf.estimate(info["time"]))
    time, deviation, truth = zip(*rows)
    return Drive(
        physics=physics,
        seed=seed,
        end_reason=info.get("end_reason", "max_steps"),
        collisions=info["collisions"],
        time=np.array(time),
        truth=np.array(truth),
        deviation=np.array(deviation),
        estimated={name: np.array([one.pose for one in many]) for name, many in estimates.items()},
        covariance={name: np.array([one.covariance[:3, :3] for one in many]) for name, many in estimates.items()},
        counts={kind: dict(counts) for kind, counts in env.robots[0].estimator.ekf.counts.items()},
    )


def run_drives(physics: tuple[str, ...], seeds: int, jobs: int) -> list[Drive]:
    """Return the drives of all physics and seeds, in order, run by `jobs` processes."""
    return run_each(run_drive, list(itertools.product(physics, range(seeds))), jobs, unit="drive")


def nees_bounds(num_drives: int) -> tuple[float, float]:
    """Return the 95 % bounds of the mean NEES of poses over drives."""
    low, high = chi2.ppf([0.025, 0.975], 3 * num_drives) / num_drives
    return float(low), float(high)


def measure(drives: list[Drive], fusion: str) -> dict[str, float]:
    """Measure a fusion over drives under one physics.

    Returns:
        The median over the drives of each of the paper's measures, and as `{name}_worst` the worst drive's. `nees`: the
        mean NEES of the pose over all drives and times, 3 for a consistent estimate, more for an overconfident one.
        `nees_within`: the share of control periods in which the mean over the drives lies within `nees_bounds`.
    """
    rows = []
    for drive in drives:
        error = drive.error(fusion) * (1.0, 1.0, np.degrees(1.0))
        rows.append((rms(np.hypot(error[:, 0], error[:, 1])), rms(error[:, 2]), *np.abs(error).max(axis=0).tolist()))
    measured = dict(zip(PAPER, zip(*rows)))
    steps = min(len(drive.time) for drive in drives)
    nees = np.array([drive.nees(fusion)[:steps] for drive in drives])
    low, high = nees_bounds(len(drives))
    mean = nees.mean(axis=0)
    return {
        **{key: float(np.median(values)) for key, values in measured.items()},
        **{f"{key}_worst": max(values) for key, values in measured.items()},
        "nees": float(nees.mean()),
        "nees_within": float(np.mean((low <= mean) & (mean <= high))),
    }
