"""The whole path: train an explorer from nothing, let the shipped ones explore an unseen house, film and report."""

import importlib.util
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from PIL import Image
from rich.console import Console
from scipy import ndimage

from agents.config import TrainingConfig
from agents.curves import LEARNED as LEARNS
from agents.curves import Row as CurveRow
from agents.curves import draw_learning_curve, read_evaluations
from benchmarks.arena.plots import (
    ERROR,
    INK,
    MUTED,
    NUM_COLORS,
    PAPER,
    UNKNOWN,
    extent_of,
    line_styles,
    show_map,
    show_only,
)
from benchmarks.arena.publish import print_results, publish, run_with_progress
from benchmarks.arena.records import Row
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.trace import Trace, trace_path
from benchmarks.films import save_film
from envs.command_line import run_command
from envs.files import Lock, read_record
from envs.measures import first_at

FOLDER = Path("runs/demo")
CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
WORLD = "turtlebot3_house"
"""Where the explorers meet. No training has seen it: `agents/frontiers/held_out.yaml` names it."""
REFERENCE, CLASSIC, LEARNED, TWIST = "nearest", "gain_over_cost", "learned", "twist"
"""The usual baseline, the best classic explorer, and the two that come with the package."""
LARGEST_RATIO = 0.5
"""Of the times to the target after and before the training; more counts as a failure of the training."""
NUM_FRAMES = 48
"""Pictures in the film."""
MARK = 0.95
"""Explored fraction that counts."""
LEAST_GAIN, POCKET_TIME = 0.01, 6.0
"""A drive that adds less than this explored fraction leads through what is known already; what is seen within this time
after it is what it led to [s]."""
INTRO = (
    "First, PPO learns to drive from an untrained network, in one small world, and is measured there, from random "
    "starts. Then explorers meet in a house that no training saw: the two that come with the package, a score of "
    "frontiers (learned) and PPO that drives with a plan in view (twist), and two classic rules, the usual baseline "
    "(nearest) and the best one (gain_over_cost). None sees ground truth: map and pose come from Hector SLAM."
)
"""First lines of the report."""


def demo(
    config: TrainingConfig,
    folder: Path,
    episodes: int = 11,
    physics: str = "bullet",
    time_limit: float | None = None,
    jobs: int = 2,
) -> str:
    """Train, evaluate with so many episodes of each explorer, film and report; return the results, in a sentence.

    The results of an earlier demo in the folder are replaced once the new ones are complete. A time limit [s] of None
    lets the environment choose.

    Raises:
        RuntimeError: if the training did not improve the time to the target coverage.
        envs.files.LockedError: if another process is at it.
    """
    from agents.training import train  # torch takes seconds to load: the first line should not wait for it

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    folder.parent.mkdir(parents=True, exist_ok=True)
    with Lock(folder.parent, f"lock-{folder.name}"):
        work = folder.with_name(f"{folder.name}.new")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        home = config.environment.world
        say(f"1/3 Train PPO in {home}, from an untrained network: {config.total_steps:,} steps")
        evaluations = read_evaluations(train(config, run=work / "training"))
        draw_learning_curve(
            {"PPO": evaluations}, f"PPO learns {home}, and is measured there", work / "learning_curve.png"
        )
        lesson = check_learning(evaluations, f"{config.environment.target_coverage:.0%} of {home}")

        say(f"2/3 Explore {WORLD}, which no training saw, with the shipped explorers: {episodes} episodes each")
        policies = (REFERENCE, CLASSIC, f"{LEARNED}=learned:pretrained/frontiers", f"{TWIST}=ppo:pretrained/twist")
        settings = Settings(
            policies=policies, worlds=(WORLD,), episodes=episodes, physics=(physics,), time_limit=time_limit
        )
        evaluation = Evaluation(settings, work)
        run_with_progress(evaluation, jobs, console)
        rows = evaluation.rows()

        say("3/3 Draw the median episode, and write the report")
        ratio, pair = median_pair(rows)
        traces = {row["policy"]: Trace.load(trace_path(work, row)) for row in pair}
        end = max(float(trace.curve.time[-1]) for trace in traces.values())
        frames = [draw_side_by_side(traces, float(moment)) for moment in np.linspace(0.0, end, NUM_FRAMES)]
        save_film(frames, work / "exploration.gif", frames[-1].shape[1])
        paths = Image.fromarray(frames[-1]).quantize(NUM_COLORS, dither=Image.Dither.NONE)
        paths.save(work / "paths.png", optimize=True)
        where = (
            f"seed {pair[0]['seed']}, the median of {episodes} starts by the ratio of times to 95 %, here {ratio:.2f}"
        )
        captions = {
            "learning_curve.png": f"{lesson} Trained and measured in this world alone, from random starts.",
            "exploration.gif": f"The shipped twist policy beside the usual baseline, in step ({where}).",
            "paths.png": "The same at the end: where each drove longest without seeing anything new.",
        }
        lead = {caption: (work / name).read_bytes() for name, caption in captions.items()}
        summary = publish(evaluation, title="From an unknown house to a finished map", intro=INTRO, lead=lead)
        print_results(evaluation, summary, console)
        _replace(folder, work)
        say("Done")
    ratios = ", ".join(f"{policy} {median_pair(rows, policy)[0]:.2f}" for policy in (CLASSIC, LEARNED, TWIST))
    result = f"Times to 95 % of {WORLD}, as shares of {REFERENCE}'s (median start): {ratios}."
    return f"{folder / 'report.html'}: {lesson} {result}"


def time_to_mark(row: Row) -> float:
    """Return the time to 95 % [s]; the time limit where it was not reached."""
    return float(min(row["time_to_95"], row["time_limit"]))


def check_learning(evaluations: Sequence[CurveRow], target: str) -> str:
    """Say how long PPO took to a target before and after its training, and the explorers that do not learn.

    Raises:
        RuntimeError: if the training did not improve it.
    """
    times = [float(row["time_to_95"]) for row in evaluations if row["policy"] == LEARNS]
    if not times[-1] <= LARGEST_RATIO * times[0]:
        raise RuntimeError(
            f"the training did not improve: {target} took {times[0]:.1f} s before and {times[-1]:.1f} s after it; "
            f"it should take at most {LARGEST_RATIO:g} of the time"
        )
    others = ", ".join(f"{row['policy']} {row['time_to_95']:.1f} s" for row in evaluations if row["policy"] != LEARNS)
    steps = int(evaluations[-1]["steps"])
    return f"PPO took {times[0]:.1f} s to {target} before training, {times[-1]:.1f} s after {steps:,} steps ({others})."


def median_pair(rows: Sequence[Row], policy: str = TWIST) -> tuple[float, tuple[Row, Row]]:
    """Return the median ratio of the times of a policy and the reference, and their episodes from that start."""
    reference = {row["seed"]: row for row in rows if row["policy"] == REFERENCE}
    pairs = [(row, reference[row["seed"]]) for row in rows if row["policy"] == policy]
    ratios = sorted(((time_to_mark(a) / time_to_mark(b), k) for k, (a, b) in enumerate(pairs)))
    ratio, k = ratios[len(ratios) // 2]
    return ratio, pairs[k]


class Return(NamedTuple):
    """The longest drive through what was known already, before `MARK` was reached."""

    begin: float
    end: float
    """Times between which less than `LEAST_GAIN` was added [s]."""
    pocket: np.ndarray
    """Shape of the map, bool: the largest connected part of what was seen first on this drive or at its end."""
    left_at: float
    """Since when the pocket bordered on what was known, the median of the cells along it [s]."""


def find_return(trace: Trace) -> Return:
    """Find the longest drive through what was known, and the pocket that it led to."""
    time, fraction = trace.curve.time, np.maximum.accumulate(trace.curve.progress)
    begins = time[np.searchsorted(fraction, fraction - LEAST_GAIN, side="right")]
    last = int(np.where(time <= first_at(time, fraction, MARK), time - begins, 0.0).argmax())
    begin, end = float(begins[last]), float(time[last])
    since, is_free = trace.known_since, (trace.grid.data >= 0) & (trace.grid.data < 50)
    new = is_free & (since > begin) & (since <= end + POCKET_TIME)
    labels, _ = ndimage.label(new, np.ones((3, 3)))
    pocket = labels == np.bincount(labels[new], minlength=2).argmax() if new.any() else new
    border = ndimage.binary_dilation(pocket, iterations=2) & is_free & (since <= begin)
    return Return(begin, end, pocket, float(np.median(since[border])) if border.any() else begin)


def draw_side_by_side(traces: Mapping[str, Trace], moment: float) -> np.ndarray:
    """Draw two episodes from the same start, by the names of their explorers, as they were at a moment [s].

    Returns:
        The picture, shape (height, width, 3), uint8.
    """
    extent, end = extent_of(list(traces.values())), max(float(trace.curve.time[-1]) for trace in traces.values())
    height = 5.0 * (extent[3] - extent[2]) / (extent[1] - extent[0])
    figure = Figure(figsize=(10.0, height + 3.0), dpi=100, facecolor=PAPER, layout="constrained")
    maps, below = figure.subfigures(2, height_ratios=(height + 0.9, 2.1))
    what = "red: the longest drive that added less than 1 %, and the pocket that it led to"
    maps.supxlabel(f"paths: coloured by time; {what}", color=MUTED, fontsize=9)
    curves, looks = below.subplots(), line_styles(list(traces))
    curves.axhline(100 * MARK, color=MUTED, linewidth=0.8, linestyle=(0, (2, 3)))
    for axes, (name, trace) in zip(maps.subplots(1, 2), traces.items(), strict=True):
        time, percent, found = trace.curve.time, 100 * trace.curve.progress, find_return(trace)
        _draw_path(axes, trace, found, moment, end)
        show_only(axes, extent, UNKNOWN)
        reached, back, past = first_at(time, trace.curve.progress, MARK), "", time <= moment
        curves.plot(time[past], percent[past], linewidth=2.0, label=name, **looks[name])
        if found.begin < found.end <= moment:
            area = found.pocket.sum() * trace.grid.resolution**2
            back = f"{found.end - found.begin:.0f} s back to {area:.1f} m² left at {found.left_at:.0f} s"
            level = float(np.interp(found.end, time, percent))
            curves.plot([found.begin, found.end], [level, level], color=ERROR, linewidth=5.0, alpha=0.55)
        now = f"{np.interp(moment, time, percent):.0f} %"
        first = now if moment < reached else f"{100 * MARK:.0f} % after {reached:.0f} s"
        axes.set_title(f"{name}: {first}\n{back}", color=INK, fontsize=11)
    curves.set(xlim=(0, end), ylim=(0, 102), xlabel="time [s]", ylabel="explored [%]")
    curves.imshow(np.linspace(0, 1, 256)[None], cmap="viridis", extent=(0, end, 0, 3), aspect="auto")
    curves.grid(color=MUTED, alpha=0.25)
    curves.legend(loc="lower right", frameon=False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw_path(axes: Axes, trace: Trace, found: Return, moment: float, end: float) -> None:
    """Draw what was known, and the path until a moment [s], in colours that begin at 0 and end at `end` [s]."""
    known = trace.known_since <= moment
    picture = np.full((*known.shape, 4), to_rgba(UNKNOWN), dtype=np.float32)
    picture[known] = to_rgba(PAPER)
    if moment >= found.left_at:
        picture[found.pocket] = to_rgba(ERROR, 0.25 if moment >= found.end else 0.55)
    picture[known & (trace.grid.data >= 50)] = to_rgba(INK)
    show_map(axes, picture, trace.grid, trace.start, trace.segments, MUTED)  # red is for returns
    count = max(int(np.searchsorted(trace.curve.time, moment, side="right")), 2)
    trail, time = trace.start.transform(trace.trail[:count]), trace.curve.time[:count]
    back = trail[(time >= found.begin) & (time <= found.end)]
    axes.plot(*back.T, color=ERROR, linewidth=5.0, alpha=0.55, solid_capstyle="round")
    if found.begin < found.end:
        axes.plot(*back[:1].T, marker="X", markersize=10, color=ERROR, markeredgecolor=PAPER)
    look = {"cmap": "viridis", "norm": Normalize(0, end), "linewidths": 1.8}
    axes.add_collection(LineCollection(list(np.stack([trail[:-1], trail[1:]], axis=1)), array=time[1:], **look))
    axes.plot(*trail[0], marker="o", markersize=6, color=PAPER, markeredgecolor=INK)
    now = matplotlib.colormaps["viridis"](time[-1] / end)
    axes.plot(*trail[-1], marker="o", markersize=7, color=now, markeredgecolor="k")


def _replace(folder: Path, work: Path) -> None:
    """Put the new results where the old ones are."""
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    work.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def main() -> None:
    """Run the demo."""
    physics = "bullet" if importlib.util.find_spec("pybullet") else "kinematic"
    try:
        print(demo(read_record(CONFIG, TrainingConfig), FOLDER, physics=physics))
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped; an earlier demo in {FOLDER} is as it was\n")
        sys.exit(130)


if __name__ == "__main__":
    run_command(main)
