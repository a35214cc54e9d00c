"""Run SLAMs on the log of a real robot: `python -m lidarnaut.envs.logs.replay LOG --relations FILE --out DIR`."""

import dataclasses
import json
import logging
import math
import re
import sys
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich import box
from rich.table import Table
from tqdm import tqdm

from lidarnaut.envs.command_line import make_console, plus_minus, run_command
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.files import own_folder, write_file
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import DEFAULT_SLAM, SLAM_NAMES, base_name, load_params, make_slam, read_params

from .log import Log, load_log
from .relations import load_labelled
from .runs import MAX_CONFLICTS, Run, measure, replay, save_replay
from .trajectory import SCALE_T

TRUTH = "truth"
SPARSE = 0.5
"""The preset `sparse` is suggested from this median distance between scans [m]."""
NOTABLE_SCALE, MAX_SCALE_ERROR = 0.01, 0.05
"""Differences of scale between odometry and map are reported from the first, and distrusted from the second."""
MAX_SCALE_STD = 0.005
"""Maximum standard error of the factor of distances. Simulated house: 0.0013 to 0.0044 for right maps, 0.0033 to 0.032
for maps that shrink; Intel Research Lab, right maps: at most 0.0021."""


@dataclass(frozen=True)
class Options:
    """Options for running SLAMs on the log of a real robot."""

    log: Annotated[Path, tyro.conf.Positional]
    """Log: arrays (.npz), CARMEN text (.log, .log.gz, .clf), or ROS bag (.bag, .mcap, folder)."""
    slam: Annotated[str | tuple[str, ...], tyro.conf.arg(constructor=tuple[str, ...])] = (DEFAULT_SLAM,)
    """SLAMs, compared in a table if several: names (`odometry` maps at odometry poses), also with parameters, such as
    `hector?preset=sparse,num_levels=3`, `module:attribute` of your own, or `all` for those of the package."""
    preset: str = "default"
    """Parameter preset of the SLAMs, or YAML file; `sparse` for scans about one metre apart, `intel` for the Intel
    Research Lab log."""
    change: dict[str, str] = field(default_factory=dict)
    """SLAM parameters to change, as `KEY VALUE` pairs."""
    relations: Path | None = None
    """File of hand-verified relative poses, `t1 t2 x y z roll pitch yaw`; optional mask `unambiguous_relations.npy` in
    the same folder."""
    out: Path | None = None
    """Output folder: maps (PNG, PGM), trajectories (TUM), pose graphs (g2o) and `summary.json`."""
    seeds: int = 1
    """Number of runs with different random seeds."""
    first_seed: int = 0
    """Random seed of the first run; later runs add 1."""
    max_range: float | None = None
    """Readings of at least this range count as no return [m]; default: the log's limit."""
    min_range: float | None = None
    """Readings below this range are ignored [m]; default: the log's limit."""
    no_return: str | None = None
    """Meaning of ranges of 0.0: `zero` (no return, as of the LDS-01) or `inf` (invalid); default: that of `--robot`,
    otherwise `inf`."""
    field_of_view: float | None = None
    """Angle from first to last beam of CARMEN's FLASER lines [rad]; default: as in CARMEN."""
    thin: tuple[float, float] | None = None
    """Minimum travel [m] or rotation [rad] between used scans."""
    time_offset: float = 0.0
    """Offset added to the log's times [s]."""
    scan_topic: str | None = None
    """Bag topic of the scans; required if there are several."""
    odom_topic: str | None = None
    """Bag topic of the odometry: Odometry messages, or transforms such as `/tf`."""
    base_frame: str | None = None
    """Base frame in a bag; default: the child frame of the odometry."""
    odom_frame: str | None = None
    """Odometry frame in a bag, such as `odom_combined`."""
    laser_frame: str | None = None
    """Lidar frame in a bag, if ambiguous or named differently in transforms."""
    robot: str | None = None
    """Robot name or YAML file that sets odometry speed limits: 1.5 times the robot's maximum speeds. Faster motions are
    interpolated or reported. Default: 5 m/s and 10 rad/s. Its lidar sets `no_return`."""


def main(options: Options) -> list[Run]:
    """Run one or more SLAMs on a log and print the results.

    Raises:
        ValueError: invalid input, or insufficient memory.
        FileNotFoundError: no input file.
    """
    if options.seeds < 1 or options.first_seed < 0:
        raise ValueError(f"seeds must be at least 1 and first_seed 0, got {options.seeds} and {options.first_seed}")
    if not math.isfinite(options.time_offset):
        raise ValueError(f"time_offset must be finite, got {options.time_offset}")
    if options.thin is not None and not min(options.thin) >= 0.0:
        raise ValueError(f"thin must be a non-negative distance and angle, got {options.thin}")
    how = ("min_range", "field_of_view", "scan_topic", "odom_topic", "base_frame", "odom_frame", "laser_frame")
    further: dict[str, Any] = {name: getattr(options, name) for name in how}
    if options.robot is not None:
        robot = load_robot(options.robot)
        further |= {"max_speeds": (1.5 * robot.max_v, 1.5 * robot.max_w), "no_return": robot.lidar.no_return}
    if options.no_return is not None:
        further["no_return"] = options.no_return
    log = load_log(options.log, options.max_range, **further)
    log = dataclasses.replace(log, times=log.times + options.time_offset)
    if options.thin is not None:
        log = log.thinned(*options.thin)
    if (step := log.step_length) >= SPARSE and options.preset != "sparse":
        tqdm.write(f"sparse log: {step:.2f} m between scans (median); `--preset sparse` searches farther")
    relations = {} if options.relations is None else load_labelled(options.relations)
    groups, given = {"all": [name for name in SLAM_NAMES if name != TRUTH]}, options.slam
    given = (given,) if isinstance(given, str) else given
    if not (names := [*dict.fromkeys(one for name in given for one in groups.get(name, [name]))]):
        raise ValueError(f"slam needs one name or more: all, {', '.join(groups['all'])}, or module:attribute")
    runs: list[Run] = []
    for name in names:
        out = options.out / re.sub(r"[^\w.-]+", "_", name) if options.out and len(names) > 1 else options.out
        try:
            runs += _run(name, options, log, relations, out)
        except MemoryError as error:
            said = " ".join(str(error).split()) or "insufficient memory"
            raise ValueError(f"{options.log}, {name}: {said}") from error
    if len(names) > 1:
        make_console().print(comparison(runs))
        if disagreeing := _disagreement(runs):
            tqdm.write(disagreeing)
    return runs


def comparison(runs: list[Run]) -> Table:
    """Return a table of errors, scales and computation times (medians over seeds), one row per SLAM."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    heads = [f"{label}, m / deg" for label in runs[0].errors]
    further = ["distances x", "lost", "conflicts", "ms per scan: mean", "99 %", "worst", "loop closures"]
    for k, head in enumerate(["SLAM", *heads, *further]):
        table.add_column(head, justify="right" if k else "left", no_wrap=k == 0)
    for name in dict.fromkeys(run.slam for run in runs):
        own = [run for run in runs if run.slam == name]
        cells = ["{:.3f} / {:.2f}".format(*error) for error in _median_errors(own).values()]
        cells.append(_factor(*_median_scale(own)))
        cells += [f"{100 * np.median([getattr(r, f) for r in own]):.1f} %" for f in ("lost_share", "conflict_share")]
        for f in ("milliseconds", "milliseconds_p99", "milliseconds_max"):
            cells.append(f"{np.median([getattr(run, f) for run in own]):.2f}")
        counts = [run.loop_closures for run in own if run.loop_closures is not None]
        table.add_row(name, *cells, f"{np.median(counts):.0f}" if counts else "")
    return table


def _run(name: str, options: Options, log: Log, relations: dict[str, np.ndarray], out: Path | None) -> list[Run]:
    slam = _make_slam(name, options, log)
    slam.reset(np.random.default_rng(options.first_seed))
    for ranges in log.ranges[:8]:  # compile kernels before timing; large motions make key scans
        slam.update(Reading.of_scan(ranges), Pose2D(1.0, 0.0, 0.5))
    if out is not None:
        own_folder(out)
    runs = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        replayed = replay(log, slam, seed, progress=sys.stderr.isatty())
        runs.append(run := measure(log, slam, name, seed, replayed, relations))
        tqdm.write(_line(run))
        if complaint := _complaint(run):
            tqdm.write(f"warning: {complaint}")
        elif abs(run.odometry_scales[0] - 1.0) > SCALE_T * run.scale_std + NOTABLE_SCALE:
            tqdm.write(f"scale of {run.slam}: {_scale(run)}; compare the map with a measured length")
        if out is not None:
            save_replay(out, log, slam, seed, replayed)
    median = f"median of {len(runs)}: {np.median([run.milliseconds for run in runs]):.3f} ms per scan"
    for label, error in _median_errors(runs).items():
        median += "; {} {:.3f} m, {:.2f} deg".format(label, *error)
    tqdm.write(median)
    if out is not None:
        params = getattr(slam, "params", None)
        shown = asdict(params) if is_dataclass(params) and not isinstance(params, type) else None
        content: dict[str, Any] = {"log": str(options.log), "slam": name, "params": shown}
        content |= {"notes": log.notes, "runs": [asdict(run) for run in runs]}
        write_file(out / "summary.json", json.dumps(content, indent=2) + "\n")
    return runs


def _line(run: Run) -> str:
    further = f"(99 % below {run.milliseconds_p99:.3f}, worst {run.milliseconds_max:.3f})"
    line = f"{run.slam}, seed {run.seed}: {run.milliseconds:.3f} ms per scan {further}"
    line += "".join(f"; {label} {error}" for label, error in run.errors.items())
    line += "" if run.loop_closures is None else f"; {run.loop_closures} loop closures"
    line += "; odometry fits best with distances x {:.3f} and turns x {:.3f}".format(*run.odometry_scales)
    line += "" if math.isnan(run.scale_std) else f" (95 %: distances {_interval(run.scale_std)})"
    return f"{line}; lost at {100 * run.lost_share:.1f} % of scans, {100 * run.conflict_share:.1f} % of beams conflict"


def _complaint(run: Run) -> str | None:
    causes = []
    if run.lost_share > 0.0:
        causes.append(f"it was lost at {100 * run.lost_share:.1f} % of the scans")
    if math.isnan(run.conflict_share):
        causes.append("no map to compare its scans with")
    elif run.conflict_share > MAX_CONFLICTS:
        limit = f"consistent maps: at most {100 * MAX_CONFLICTS:.0f} %"
        causes.append(f"{100 * run.conflict_share:.1f} % of the beams pass through walls of its map ({limit})")
    if run.scale_std > MAX_SCALE_STD:
        causes.append(f"its scale varies along the path: {_scale(run)}")
    elif abs(run.odometry_scales[0] - 1.0) > MAX_SCALE_ERROR > SCALE_T * run.scale_std:
        causes.append(f"its scale or odometry's is wrong: {_scale(run)}")
    return f"do not trust {run.slam}, seed {run.seed}: {'; '.join(causes)}" if causes else None


def _scale(run: Run) -> str:
    return f"distances are {_factor(run.odometry_scales[0], run.scale_std)} times those of odometry"


def _factor(scale: float, std: float) -> str:
    return f"{scale:.3f}" if math.isnan(std) else f"{scale:.3f} {_interval(std)}"


def _interval(std: float) -> str:
    return plus_minus(SCALE_T * std, 3)


def _median_scale(runs: list[Run]) -> tuple[float, float]:
    scale, std = np.median([(run.odometry_scales[0], run.scale_std) for run in runs], axis=0).tolist()
    return scale, std


def _disagreement(runs: list[Run]) -> str:
    """Return a line that names the SLAMs with the smallest and the largest scale if their intervals are apart."""
    names = dict.fromkeys(run.slam for run in runs if base_name(run.slam) != "odometry")
    found = {name: _median_scale([run for run in runs if run.slam == name]) for name in names}
    known = {name: one for name, one in found.items() if not math.isnan(one[1])}
    if not known:
        return ""
    low = min(known, key=lambda name: known[name][0] + SCALE_T * known[name][1])
    high = max(known, key=lambda name: known[name][0] - SCALE_T * known[name][1])
    (first, first_std), (last, last_std) = known[low], known[high]
    if last - first <= SCALE_T * (first_std + last_std):
        return ""
    told = f"{low} ({_factor(first, first_std)}) and {high} ({_factor(last, last_std)})"
    return f"the scales of {told} disagree: their intervals are statistical only, without the distortion of a map"


def _median_errors(runs: list[Run]) -> dict[str, np.ndarray]:
    errors = [{label: (e.translation, e.rotation) for label, e in run.errors.items()} for run in runs]
    return {label: np.median([error[label] for error in errors], axis=0) for label in errors[0]}


def _make_slam(name: str, options: Options, log: Log) -> Estimator:
    base = base_name(name)
    if base == TRUTH:
        raise ValueError("slam 'truth' requires ground truth, which logs lack; use `odometry` to map at recorded poses")
    further = options.change.keys() - {"resolution"}
    if base is None:
        if further:
            raise ValueError(f"{name} has no parameters {', '.join(sorted(further))}")
        return make_slam(name, log.lidar, load_params(options.preset, options.change).resolution)
    params = read_params(name, options.preset, options.change)
    return make_slam(base, log.lidar, params.resolution, params)


def cli() -> None:
    """Run `main` with options of the command line."""
    logging.basicConfig(format="warning: %(message)s")
    run_command(main, options=Options, status=1)


if __name__ == "__main__":
    cli()
