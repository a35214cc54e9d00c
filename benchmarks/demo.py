"""Train a policy for crowds from nothing, let the shipped explorers explore an unseen house, film and report."""

import importlib.util
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console

from lidarnaut.agents.config import TrainingConfig, change
from lidarnaut.agents.curves import LEARNED as LEARNS
from lidarnaut.agents.curves import Row as CurveRow
from lidarnaut.agents.curves import draw_learning_curve, read_evaluations
from lidarnaut.benchmarks.arena.plots import STYLE, draw_growth, draw_map, extent_of, render
from lidarnaut.benchmarks.arena.publish import print_results, publish, run_with_progress
from lidarnaut.benchmarks.arena.records import Row
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import Trace, trace_path
from lidarnaut.benchmarks.films import save_film
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import Lock, parse_record, read_mapping

FOLDER = Path("runs/demo")
CONFIG = Path(__file__).parents[1] / "configs" / "reach_crowd.yaml"
TRAINING = {
    "total_steps": 500_000,
    "environment.people.attentive": 0.5,
    "evaluation.every": 125_000,
    "evaluation.episodes": 100,
    "evaluation.references": ["pursuit", "dwb"],
}
"""What the demo changes of that configuration."""
WORLD = "turtlebot3_house"
"""Where the explorers meet. No training has seen it: `agents/frontiers/held_out.yaml` names it."""
REFERENCE, CLASSIC, LEARNED, TWIST = "nearest", "gain_over_cost", "learned", "twist"
"""The usual baseline, the best classic explorer, and the two that come with the package."""
RIVAL = "pursuit"
"""The classic controller above whose success the training must end."""
NUM_FRAMES = 48
"""Pictures in the film."""
INTRO = (
    "First, PPO learns from an untrained network to reach goals among people, of whom half do not see the robot, and "
    "is measured in halls that it does not train in, beside classic controllers. Then explorers meet in a house that "
    "no training saw: the two that come with the package, a score of "
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
        RuntimeError: if the training did not get above a classic controller.
        lidarnaut.envs.files.LockedError: if another process is at it.
    """
    from lidarnaut.agents.training import train  # torch takes seconds to load: the first line should not wait for it

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    folder.parent.mkdir(parents=True, exist_ok=True)
    with Lock(folder.parent, f"lock-{folder.name}"):
        work = folder.with_name(f"{folder.name}.new")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        task = config.environment.id.removeprefix("lidarnaut/")
        say(f"1/3 Train PPO in {task}, from an untrained network: {config.total_steps:,} steps")
        evaluations = read_evaluations(train(config, run=work / "training"))
        draw_learning_curve({"PPO": evaluations}, f"PPO learns {task}", work / "learning_curve.png")
        lesson = check_learning(evaluations, task)

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
        frames = [draw_moment(traces, float(moment), end) for moment in np.linspace(0.0, end, NUM_FRAMES)]
        save_film(frames, work / "exploration.gif", frames[-1].shape[1])
        (work / "paths.png").write_bytes(render(draw_growth, traces))
        where = (
            f"seed {pair[0]['seed']}, the median of {episodes} starts by the ratio of times to 95 %, here {ratio:.2f}"
        )
        captions = {
            "learning_curve.png": f"{lesson} The same episodes for all.",
            "exploration.gif": f"The shipped twist policy beside the usual baseline, in step ({where}).",
            "paths.png": "The same, moment by moment.",
        }
        lead = {caption: (work / name).read_bytes() for name, caption in captions.items()}
        summary = publish(evaluation, title="From an unknown house to a finished map", intro=INTRO, lead=lead)
        print_results(evaluation, summary, console)
        shutil.rmtree(folder, ignore_errors=True)
        work.rename(folder)
        say("Done")
    ratios = ", ".join(f"{policy} {median_pair(rows, policy)[0]:.2f}" for policy in (CLASSIC, LEARNED, TWIST))
    result = f"Times to 95 % of {WORLD}, as shares of {REFERENCE}'s (median start): {ratios}."
    return f"{folder / 'report.html'}: {lesson} {result}"


def time_to_mark(row: Row) -> float:
    """Return the time to 95 % [s]; the time limit where it was not reached."""
    return float(min(row["time_to_95"], row["time_limit"]))


def check_learning(evaluations: Sequence[CurveRow], task: str) -> str:
    """Say how often PPO reached its goals before and after its training, and how often those that do not learn.

    Raises:
        RuntimeError: if it does not end above `RIVAL`.
    """
    shares = [float(row["success"]) for row in evaluations if row["policy"] == LEARNS]
    others = {str(row["policy"]): float(row["success"]) for row in evaluations if row["policy"] != LEARNS}
    if not shares[-1] > others[RIVAL]:
        raise RuntimeError(
            f"the training did not help: in {task}, PPO reached {shares[0]:.0%} of its goals before and "
            f"{shares[-1]:.0%} after it; it should reach more than {RIVAL}, {others[RIVAL]:.0%}"
        )
    rivals = ", ".join(f"{policy} {share:.0%}" for policy, share in others.items())
    steps = int(evaluations[-1]["steps"])
    before, after = f"{shares[0]:.0%} of its goals at first", f"{shares[-1]:.0%} after {steps:,} steps"
    return f"In {task}, PPO reached {before}, {after} ({rivals})."


def median_pair(rows: Sequence[Row], policy: str = TWIST) -> tuple[float, tuple[Row, Row]]:
    """Return the median ratio of the times of a policy and the reference, and their episodes from that start."""
    reference = {row["seed"]: row for row in rows if row["policy"] == REFERENCE}
    pairs = [(row, reference[row["seed"]]) for row in rows if row["policy"] == policy]
    ratios = sorted(((time_to_mark(a) / time_to_mark(b), k) for k, (a, b) in enumerate(pairs)))
    ratio, k = ratios[len(ratios) // 2]
    return ratio, pairs[k]


def draw_moment(traces: Mapping[str, Trace], moment: float, end: float) -> np.ndarray:
    """Draw the maps and paths of episodes from the same start, by the names of their explorers, as at a moment [s].

    Colours tell when cells became known, the last one at `end` [s]. Returns shape (height, width, 3), uint8.
    """
    extent = extent_of(list(traces.values()))
    height = 5.0 * (extent[3] - extent[2]) / (extent[1] - extent[0]) + 0.4
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.0 * len(traces), height), dpi=100)
        for axes, (name, trace) in zip(figure.subplots(1, len(traces)), traces.items()):
            time, share = trace.curve.time, trace.curve.progress
            draw_map(axes, trace, moment, end, extent)
            axes.set_title(f"{name}: {100 * np.interp(moment, time, share):.0f} % after {min(moment, time[-1]):.0f} s")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def main() -> None:
    """Run the demo."""
    physics = "bullet" if importlib.util.find_spec("pybullet") else "kinematic"
    try:
        config = parse_record(change(read_mapping(CONFIG), TRAINING), str(CONFIG), TrainingConfig)
        print(demo(config, FOLDER, physics=physics))
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped; an earlier demo in {FOLDER} is as it was\n")
        sys.exit(130)


if __name__ == "__main__":
    run_command(main)
