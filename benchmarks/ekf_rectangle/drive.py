"""One drive around the rectangle, with the estimates of all fusions."""

import itertools
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.explorer import to_action
from baselines.route_follower import RouteFollower
from envs.geometry import Pose2D, wrap_angle
from envs.localization.ekf import Ekf, Estimate
from envs.localization.fusion import FUSIONS, make_filter, start_covariance
from envs.track import TrackEnv

DRIVER = "full"
"""Fusion by which the robot drives. The others run along on the same measurements."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Record of a drive: poses in the map frame, after each control period."""

    physics: str
    """Simulator."""
    seed: int
    """Seed of the drive, and of the one that made its map."""
    end_reason: str
    """Why it ended; see `TrackEnv`."""
    collisions: int
    """Number of contacts."""
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


def make_env(physics: str, map_seed: int) -> TrackEnv:
    """Return the environment of the experiment, in which the robot knows its initial pose."""
    return TrackEnv(physics=physics, map_seed=map_seed, fusion=DRIVER, start_spread=(0.0, 0.0))


def make_started_filter(env: TrackEnv) -> Ekf:
    """Return a filter in the initial state of that by which the robot drives."""
    ekf = make_filter(env.robot)
    ekf.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
    return ekf


def follow_route(env: TrackEnv, seed: int) -> Iterator[dict[str, Any]]:
    """Drive a route to its end by the fused pose; yield `info` after each control period. Closes the environment."""
    env.reset(seed=seed)
    follower = RouteFollower()
    follower.reset(env.robot, env.control_period, env.route)
    ended = False
    try:
        while not ended:
            twist = follower.act(env.reading, env.estimate.pose)
            _, _, terminated, truncated, info = env.step(to_action(twist, env.robot))
            ended = terminated or truncated
            yield info
    finally:
        env.close()


def run_drive(physics: str, seed: int, max_steps: int | None = None) -> Drive:
    """Map the route, then drive it.

    Args:
        physics: simulator.
        seed: of the drive, and of the one that makes its map.
        max_steps: number of control periods to stop after; None drives to the end.
    """
    env = make_env(physics, map_seed=seed)
    filters = {name: make_started_filter(env) for name, kinds in FUSIONS.items() if kinds and name != DRIVER}
    rows: list[tuple[float, float, Pose2D]] = []
    estimates: dict[str, list[Estimate]] = {name: [] for name in FUSIONS}
    for info in itertools.islice(follow_route(env, seed), max_steps):
        rows.append((info["time"], info["deviation"], env.true_pose))
        estimates[DRIVER].append(env.estimate)
        estimates["amcl"].append(env.fused.localized)
        for name, ekf in filters.items():
            for measurement in env.fused.measurements:
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
        counts={kind: dict(counts) for kind, counts in env.fused.ekf.counts.items()},
    )


def run_drives(physics: tuple[str, ...], seeds: int, jobs: int) -> Iterator[Drive]:
    """Yield the drives of all physics and seeds, in order, run by `jobs` processes."""
    tasks = [(name, seed) for name in physics for seed in range(seeds)]
    if jobs == 1:
        for task in tasks:
            yield run_drive(*task)
        return
    # A fresh interpreter each: forked copies of a process that has threads may hang.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(run_drive, *zip(*tasks))
