"""One drive around the rectangle, with everything that was believed on the way."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from baselines.route_follower import RouteFollower
from envs.geometry import Pose2D
from envs.localization.ekf import Ekf, Estimate
from envs.localization.fusion import FUSIONS, make_filter, start_covariance
from envs.track import TrackEnv

DRIVER = "full"
"""Fusion by which the robot drives. The others listen to the same drive."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What came of a drive; poses in the map frame, one after each control period."""

    physics: str
    """By which physics."""
    seed: int
    """Of the drive and of the drive that made its map."""
    end_reason: str
    """Why it ended; see `TrackEnv`."""
    collisions: int
    """Contacts."""
    time: np.ndarray
    """Shape (n,), float64 [s]."""
    truth: np.ndarray
    """Shape (n, 3), float64: x, y, heading [m, m, rad]."""
    deviation: np.ndarray
    """Shape (n,), float64: how far the robot was to the left of the route [m]."""
    believed: dict[str, np.ndarray]
    """For each fusion, the same as `truth`."""
    covariance: dict[str, np.ndarray]
    """For each fusion, shape (n, 3, 3), float64, of x, y and heading."""
    counts: dict[str, dict[str, int]]
    """What became of the measurements in the full fusion: kind, verdict, number."""

    def error(self, fusion: str) -> np.ndarray:
        """Return believed less true poses, shape (n, 3), headings wrapped to [-pi, pi) [m, m, rad]."""
        error = self.believed[fusion] - self.truth
        error[:, 2] = (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return error

    def nees(self, fusion: str) -> np.ndarray:
        """Return the normalised estimation error squared, shape (n,): chi-square with 3 degrees of freedom, ideally."""
        error = self.error(fusion)
        return np.einsum("ni,ni->n", error, np.linalg.solve(self.covariance[fusion], error[..., None])[..., 0])


def make_env(physics: str, map_seed: int) -> TrackEnv:
    """Return the environment of the experiment, with a robot that starts where it believes to."""
    return TrackEnv(physics=physics, map_seed=map_seed, fusion=DRIVER, start_spread=(0.0, 0.0))


def run_drive(physics: str, seed: int, max_steps: int | None = None) -> Drive:
    """Map the route, then drive it.

    Args:
        physics: by which physics.
        seed: of both drives.
        max_steps: stop after so many control periods; None drives to the end.
    """
    env = make_env(physics, map_seed=seed)
    observation, info = env.reset(seed=seed)
    tracker = RouteFollower()
    tracker.reset(env.robot, env.control_period, env.route)
    listeners = {name: _listener(env) for name, kinds in FUSIONS.items() if kinds and name != DRIVER}
    rows: list[tuple[float, float, Pose2D]] = []
    estimates: dict[str, list[Estimate]] = {name: [] for name in FUSIONS}
    ended = False
    while not ended and len(rows) != max_steps:
        observation, _, terminated, truncated, info = env.step(tracker.act(observation, env.estimate.pose))
        ended = terminated or truncated
        rows.append((info["time"], info["deviation"], env.true_pose))
        estimates[DRIVER].append(env.estimate)
        estimates["amcl"].append(env.fused.localized)
        for name, ekf in listeners.items():
            for measurement in env.fused.measurements:
                if measurement.kind in FUSIONS[name]:
                    ekf.add(measurement)
            estimates[name].append(ekf.estimate(info["time"]))
    env.close()
    time, deviation, truth = zip(*rows)
    return Drive(
        physics=physics,
        seed=seed,
        end_reason=info.get("end_reason", "max_steps"),
        collisions=info["collisions"],
        time=np.array(time),
        truth=np.array(truth),
        deviation=np.array(deviation),
        believed={name: np.array([one.pose for one in many]) for name, many in estimates.items()},
        covariance={name: np.array([one.covariance[:3, :3] for one in many]) for name, many in estimates.items()},
        counts={kind: dict(counts) for kind, counts in env.fused.ekf.counts.items()},
    )


def run_drives(physics: tuple[str, ...], seeds: int, jobs: int) -> Iterator[Drive]:
    """Yield the drives of all physics and seeds, in order, from so many processes."""
    tasks = [(name, seed) for name in physics for seed in range(seeds)]
    if jobs == 1:
        for task in tasks:
            yield run_drive(*task)
        return
    # A fresh interpreter each: forked copies of a process that has threads may hang.
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(run_drive, *zip(*tasks))


def _listener(env: TrackEnv) -> Ekf:
    """Return a filter that starts as the driving one did."""
    ekf = make_filter(env.robot)
    ekf.reset(Pose2D(0.0, 0.0, 0.0), start_covariance())
    return ekf
