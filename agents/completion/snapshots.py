"""Training data: maps at random moments of explorations, with the true floor."""

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from scipy import ndimage

from lidarnaut.agents.frontiers.features import NEAREST, PRIOR
from lidarnaut.agents.frontiers.score import FrontierScore
from lidarnaut.agents.frontiers.tasks import TARGET, ExplorationTask, draw_task, make_environment, make_world
from lidarnaut.baselines import EXPLORERS
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.core import LidarEnv, lidar_env_of
from lidarnaut.envs.files import open_archive, write_file

from .raster import CELL, FREE, OCCUPIED, true_floor, turned_raster, wall_direction

FLOOR = 4
"""Bit of a cell that belongs to the floor that the robot can explore; beside `FREE` and `OCCUPIED`."""
GAPS = 0.02, 0.06
"""Range of the explored fraction between two snapshots."""
SLAMS = "hector", "hector", "tinyslam", "gmapping", "graph"
EXPLORING = "nearest", "gain_over_cost", "pursuit", "tour"
"""Explorers of driven episodes."""
DRIVEN_SHARE, BULLET_SHARE = 0.08, 0.15
"""Fraction of driven episodes, others slide along paths; and fraction of driven ones with PyBullet."""
TEMPERATURES = 0.0, 0.0, 0.3, 1.0
"""Scales of noise on the scores of frontiers, which varies the order of exploration."""
MAX_TIME = 600.0
"""Maximum time of a driven episode [s]."""


class Snapshot(NamedTuple):
    """Map in the midst of an exploration."""

    cells: np.ndarray
    """Bits `FREE`, `OCCUPIED` and `FLOOR` of the cells of a turned raster, shape (height, width), uint8."""

    @property
    def codes(self) -> np.ndarray:
        """Known cells, as in `TurnedRaster`."""
        return self.cells & (FREE | OCCUPIED)

    @property
    def floor(self) -> np.ndarray:
        """True floor, shape (height, width), bool."""
        return self.cells & FLOOR > 0


class Camera:
    """Takes snapshots of one exploration, at random explored fractions."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.snapshots: list[np.ndarray] = []
        self._rng, self._angle, self._next = rng, math.nan, float(rng.uniform(0.0, GAPS[0]))

    def watch(self, explore: LidarEnv) -> None:
        """Take a snapshot of an environment's map if it is time for one."""
        coverage = explore.task.coverage
        assert coverage is not None
        if self._next <= (explored := coverage.explored_fraction) <= TARGET:
            self._next = explored + float(self._rng.uniform(*GAPS))
            self._angle = wall_direction(explore.belief.grid, self._angle)
            raster = turned_raster(explore.belief.grid, self._angle)
            self.snapshots.append(raster.codes | FLOOR * true_floor(coverage, raster).astype(np.uint8))


def collect(seed: tuple[int, ...], episodes: int, families: tuple[str, ...]) -> list[np.ndarray]:
    """Return the snapshots of some explorations in random training worlds, as `Snapshot.cells`."""
    rng, found = np.random.default_rng(seed), list[np.ndarray]()
    for _ in range(episodes):
        camera, task = Camera(rng), draw_task(rng, families)
        (_drive if rng.random() < DRIVEN_SHARE else _slide)(task, camera, rng)
        found += camera.snapshots
    return found


def _slide(task: ExplorationTask, camera: Camera, rng: np.random.Generator) -> None:
    score, noise = FrontierScore((NEAREST, PRIOR)[int(rng.integers(2))]), float(rng.choice(TEMPERATURES))
    env = make_environment(task.robot, task.resolution, task.drift)
    observation, _ = env.reset(seed=task.seed, options={"world": make_world(task)})
    while not any(env.explore.is_over) and len(env.candidates):
        camera.watch(env.explore)
        scores = score.rate(observation)[1]
        env.apply(np.int64((scores + noise * rng.gumbel(size=len(scores))).argmax()))
        observation = env.observe(observation)


def _drive(task: ExplorationTask, camera: Camera, rng: np.random.Generator) -> None:
    physics = "bullet" if rng.random() < BULLET_SHARE else "kinematic"
    how: dict[str, Any] = {"slam": str(rng.choice(SLAMS)), "physics": physics, "time_limit": MAX_TIME}
    policy: Callable[[], Any] = EXPLORERS[str(rng.choice(EXPLORING))]
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world=make_world(task), robot=task.robot, target_coverage=TARGET, **how
    )
    inner = lidar_env_of(env)
    run_episode(env, policy(), task.seed, lambda _: camera.watch(inner))
    env.close()


def save_snapshots(path: Path, snapshots: list[np.ndarray]) -> None:
    """Write snapshots, given as `Snapshot.cells`, to a NumPy archive."""
    shapes, archive = np.array([cells.shape for cells in snapshots], dtype=np.int32).reshape(-1, 2), io.BytesIO()
    cells = np.concatenate([np.empty(0, dtype=np.uint8), *(cells.ravel() for cells in snapshots)])
    np.savez_compressed(archive, shapes=shapes, cells=cells)
    write_file(path, archive.getvalue())


def load_snapshots(path: Path) -> list[Snapshot]:
    """Read snapshots from a NumPy archive; ValueError if it is damaged."""
    with open_archive(path, "file of snapshots", "remove it to collect them again") as archive:
        shapes, cells = archive["shapes"], archive["cells"]
        ends = np.cumsum(shapes.astype(np.int64).prod(axis=1))
        if cells.ndim != 1 or cells.dtype != np.uint8 or (ends[-1] if len(ends) else 0) != len(cells):
            raise ValueError(f"not {len(shapes)} rasters")
        parts = np.split(cells, ends[:-1]) if len(ends) else []
        return [Snapshot(part.reshape(shape)) for part, shape in zip(parts, shapes.tolist(), strict=True)]


def floor_distance(codes: np.ndarray) -> np.ndarray:
    """Return the distance of each cell from known floor, shape of the codes, float64 [m]; inf without any."""
    floor = codes == FREE
    if not floor.any():
        return np.full(codes.shape, math.inf)
    distances: np.ndarray = ndimage.distance_transform_edt(~floor) * CELL
    return distances
