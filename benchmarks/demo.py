"""The whole path in a few minutes: train a small explorer, compare it with the classic one, film and report."""

import contextlib
import shutil
import sys
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
from rich.console import Console

from agents.config import TrainingConfig
from baselines.episode import run_episode
from benchmarks.arena.measures import BY_NAME
from benchmarks.arena.pairs import by_start, start_of
from benchmarks.arena.policies import Policy
from benchmarks.arena.publish import print_case, publish, run_with_progress
from benchmarks.arena.records import Row
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.summary import Summary, typical_and_worst
from benchmarks.arena.trace import load_curve
from benchmarks.pictures import Film, save_gif
from envs.explore import ExploreEnv
from envs.files import read_record

FOLDER = Path("runs/demo")
CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
WORLD = "turtlebot3_world"
"""Where the explorers meet. The learned one has never been there: it is trained on procedural worlds."""
NUM_FRAMES = 80
"""Pictures in a film, about."""
INTRO = (
    "A small PPO explorer was trained for a few minutes on procedural worlds. Here it explores a world that it has "
    "never seen, beside the classic frontier explorer and one that drives at random. None of them sees ground truth: "
    "map and pose come from TinySLAM."
)
"""First lines of the report."""


def demo(
    config: TrainingConfig,
    folder: Path,
    episodes: int = 10,
    physics: str = "bullet",
    time_limit: float | None = None,
    jobs: int = 2,
) -> str:
    """Train, evaluate with so many episodes of each explorer, film and report; return the results, in a sentence.

    The results of an earlier demo in the folder are replaced once the new ones are complete. A time limit [s] of None
    lets the environment choose.
    """
    from agents.training import train  # torch takes seconds to load: the first line should not wait for it

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    work = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    say(f"1/3 Train a PPO explorer on procedural {config.environment.world}: {config.total_steps:,} steps")
    run = train(config, run=work / "training")
    shutil.copy(run / "learning_curve.png", work)

    say(f"2/3 Explore {WORLD} with it, with the classic explorer, and at random: {episodes} episodes each")
    policies = (f"ppo=ppo:{run}", "frontier", "random")
    settings = Settings(
        policies=policies, worlds=(WORLD,), episodes=episodes, physics=(physics,), time_limit=time_limit
    )
    evaluation = Evaluation(settings, work)
    run_with_progress(evaluation, jobs, None, console)
    rows = evaluation.rows()

    say("3/3 Film the first episode, and write the report")
    learned, classic, _ = evaluation.policies.values()
    median = typical_and_worst(rows, learned.name)[0]
    same = by_start(rows, classic.name)[start_of(median)]
    title = f"The trained explorer in a world that it has never seen (seed {median['seed']}, its median episode)."
    lead = {
        title: _film(settings, learned, median, work, "exploration.gif"),
        "The classic explorer from the same start.": _film(settings, classic, same, work, "exploration_frontier.gif"),
        "How the explorer learned, on worlds of the test split.": (work / "learning_curve.png").read_bytes(),
    }
    summary = publish(evaluation, title="From an unknown world to a finished map", intro=INTRO, lead=lead)
    print_case(console, summary, WORLD)
    _replace(folder, work)
    say("Done")
    return _sentence(summary, folder)


def _film(settings: Settings, policy: Policy, row: Row, folder: Path, name: str) -> bytes:
    """Run an episode of the evaluation once more, film it for as long as something new is seen, and return the film."""
    curve = load_curve(folder, row)
    case, _, _ = next(settings.starts())
    seen_all = float(curve.time[np.argmax(curve.explored_fraction == curve.explored_fraction[-1])])
    with contextlib.closing(case.make_env(settings.time_limit, render_mode="rgb_array")) as env:
        film = Film(cast(ExploreEnv, env.unwrapped), every=max(seen_all / NUM_FRAMES, 0.1))

        def watch(info: dict[str, Any]) -> None:
            if info["time"] <= seen_all:
                film.shoot(info)

        run_episode(env, policy.make(), row["seed"], watch)
        film.finish()
    save_gif(film.frames, folder / name, width=800)
    return (folder / name).read_bytes()


def _replace(folder: Path, work: Path) -> None:
    """Put the new results where the old ones are."""
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    work.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _sentence(summary: Summary, folder: Path) -> str:
    """Say where the report lies, and its three most interesting numbers."""

    def number(policy: str, measure: str) -> str:
        number, interval = BY_NAME[measure].texts(summary[policy][WORLD][measure])
        return interval if interval == "never" else f"{number} {BY_NAME[measure].unit}"

    explored, reached = (
        {policy: number(policy, measure) for policy in ("ppo", "frontier", "random")}
        for measure in ("explored_fraction", "time_to_90")
    )
    return (
        f"{folder / 'report.html'}: the trained explorer saw {explored['ppo']} of {WORLD} "
        f"(frontier {explored['frontier']}, random {explored['random']}), "
        f"time to 90 % of it: {reached['ppo']} (frontier: {reached['frontier']}, random: {reached['random']}), "
        f"position error {number('ppo', 'position_rmse')}."
    )


def main() -> int:
    """Run the demo; return the exit status."""
    try:
        print(demo(read_record(CONFIG, TrainingConfig), FOLDER))
    except KeyboardInterrupt:
        print(f"stopped; an earlier demo in {FOLDER} is as it was", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
