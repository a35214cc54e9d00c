"""Run a SLAM on the log of a real robot: `python -m envs.slam.replay LOG --relations FILE --out DIR`."""

import json
import sys
import time
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from PIL import Image, ImageDraw
from tqdm import tqdm

from envs.estimation import Estimator
from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from envs.logs import Log, RelationError, follow_odometry, load_log, load_relations, relation_error, save_trajectory
from envs.worlds import save_map

from . import SLAMS, load_params, make_slam

LABELS = {"error": "relation error", "error_unambiguous": "unambiguous"}
"""How errors of a `Run` are called in what is printed."""


@dataclass(frozen=True)
class Options:
    """Run a SLAM on the log of a real robot; print its relation error and the time per scan."""

    log: Annotated[Path, tyro.conf.Positional]
    """Arrays (.npz) or CARMEN text (.log, .log.gz, .clf)."""
    slam: str = "tinyslam"
    """Name of a SLAM (`odometry` maps at the poses of the wheel odometry), or `module:attribute` of your own, which is
    called with the lidar's geometry and the resolution [m]."""
    preset: str = "intel"
    """Preset of the SLAM's parameters, or a YAML file. A SLAM of your own gets its resolution alone."""
    change: dict[str, str] = field(default_factory=dict)
    """Parameters to change, as `KEY VALUE` pairs."""
    relations: Path | None = None
    """Hand-verified relations, `t1 t2 x y z roll pitch yaw`. If `unambiguous_relations.npy` lies in the same folder, a
    boolean mask, the error over those is printed as well."""
    out: Path | None = None
    """Folder for maps (PNG, and PGM with YAML), trajectories (TUM format) and `summary.json`."""
    seeds: int = 1
    """Number of runs."""
    first_seed: int = 0
    """Seed of the first run."""
    max_range: float | None = None
    """Readings from this on count as no return [m]; the log's own limit by default."""
    time_offset: float = 0.0
    """Added to the log's times, for relations with another clock [s]."""


@dataclass(frozen=True, slots=True)
class Run:
    """Result of one run."""

    seed: int
    milliseconds: float
    """Mean time per scan [ms]."""
    error: RelationError | None = None
    """Over all relations."""
    error_unambiguous: RelationError | None = None
    """Over those whose time stamps are unambiguous."""


def replay(log: Log, slam: Estimator, seed: int, progress: bool = False) -> tuple[np.ndarray, float]:
    """Reset a SLAM with a seed, and run it along a log.

    Returns:
        Estimated poses at the scans, shape (m, 3) [m, rad], and the mean time per scan [s].
    """
    slam.reset(np.random.default_rng(seed))
    poses = np.empty((len(log.ranges), 3))
    spent = 0.0
    steps = zip(log.ranges, log.motions())
    for k, (ranges, motion) in enumerate(tqdm(steps, f"seed {seed}", len(poses), leave=False, disable=not progress)):
        begin = time.perf_counter()
        poses[k] = slam.update(ranges, motion).pose
        spent += time.perf_counter() - begin
    return poses, spent / len(poses)


def picture(grid: OccupancyGrid, positions: np.ndarray | None = None, margin: int = 10) -> Image.Image:
    """Draw a map, cropped to what is known and a margin [cells]: white free, black occupied, grey unknown.

    The path in blue goes through `positions`, shape (n, 2), in the map frame [m].
    """
    rows, cols = np.nonzero(grid.data != UNKNOWN)
    height, width = grid.data.shape
    top, bottom = max(rows.min() - margin, 0), min(rows.max() + margin + 1, height)
    left, right = max(cols.min() - margin, 0), min(cols.max() + margin + 1, width)
    cells = grid.data[top:bottom, left:right].astype(float)
    grey = np.where(cells == UNKNOWN, 190.0, 255.0 - 2.55 * cells).round().astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(grey[::-1])).convert("RGB")
    if positions is not None:
        corner = np.array(grid.origin) + np.array([left, top]) * grid.resolution
        points = (positions - corner) / grid.resolution
        points[:, 1] = bottom - top - points[:, 1]
        ImageDraw.Draw(image).line([tuple(point) for point in points.tolist()], fill=(40, 90, 220))
    return image


def main(options: Options) -> list[Run]:
    """Run the command.

    Raises:
        ValueError: the SLAM cannot be replayed, or an input file or parameter is not valid.
        FileNotFoundError: an input file is missing.
    """
    log = load_log(options.log, options.max_range)
    times = log.times + options.time_offset
    relations = _load_relations(options.relations)
    slam = _make_slam(options, log)
    slam.reset(np.random.default_rng(options.first_seed))
    for ranges in log.ranges[:2]:  # compile the kernels, which must not be timed
        slam.update(ranges, Pose2D(0.0, 0.0, 0.0))
    out, runs = options.out, []
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        poses, seconds = replay(log, slam, seed, progress=sys.stderr.isatty())
        trajectory = follow_odometry(log.odometry, log.scan_rows, poses)
        errors = {name: relation_error(times, trajectory, some) for name, some in relations.items()}
        runs.append(Run(seed, 1e3 * seconds, **errors))
        known = "".join(f"; {LABELS[name]} {error}" for name, error in errors.items())
        tqdm.write(f"seed {seed}: {runs[-1].milliseconds:.3f} ms per scan{known}")
        if out is not None:
            grid = slam.belief.grid
            picture(grid, poses[:, :2]).save(out / f"map_with_path_{seed}.png", optimize=True)
            save_map(grid, out / f"map_{seed}.pgm")
            save_trajectory(out / f"trajectory_{seed}.tum", times, trajectory)
    median = f"median of {len(runs)}: {np.median([run.milliseconds for run in runs]):.3f} ms per scan"
    for name in relations:
        found = [(error.translation, error.rotation) for error in (getattr(run, name) for run in runs)]
        median += "; {} {:.3f} m, {:.2f} deg".format(LABELS[name], *np.median(found, axis=0))
    tqdm.write(median)
    if out is not None:
        params = getattr(slam, "params", None)
        content = {
            "log": str(options.log),
            "slam": options.slam,
            "params": asdict(params) if is_dataclass(params) and not isinstance(params, type) else None,
            "runs": [asdict(run) for run in runs],
        }
        (out / "summary.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return runs


def _make_slam(options: Options, log: Log) -> Estimator:
    if options.slam == "truth":
        raise ValueError(
            "slam 'truth' maps at true poses, which a log does not hold; `odometry` maps at the recorded ones"
        )
    further = options.change.keys() - {"resolution"}
    if options.slam not in SLAMS:
        if further:
            raise ValueError(f"{options.slam} has no parameters {', '.join(sorted(further))} that could be changed")
        return make_slam(options.slam, log.lidar, load_params(options.preset, options.change).resolution)
    params = SLAMS[options.slam].load(options.preset, options.change)
    return make_slam(options.slam, log.lidar, params.resolution, params)


def _load_relations(path: Path | None) -> dict[str, np.ndarray]:
    """Return relations, as far as there are files, by the field of `Run` that holds the error over them."""
    if path is None:
        return {}
    relations = {"error": load_relations(path)}
    mask = path.parent / "unambiguous_relations.npy"
    if mask.is_file():
        relations["error_unambiguous"] = relations["error"][np.load(mask)]
    return relations


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except (ValueError, OSError, MemoryError) as error:
        sys.exit(f"error: {error}")
