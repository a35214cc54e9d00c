"""Demo: train a policy to reach goals among people, evaluate pretrained policies, and write a report."""

import contextlib
import logging
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from lidarnaut.agents.config import TrainingConfig, change
from lidarnaut.agents.curves import LEARNED_NAMES, draw_learning_curve, read_evaluations
from lidarnaut.agents.curves import Row as CurveRow
from lidarnaut.agents.policy_names import short
from lidarnaut.agents.pools import make_pool
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.leaderboard import ranking_table
from lidarnaut.benchmarks.arena.page import Cell, Figure, Frame, Section, Table, to_html
from lidarnaut.benchmarks.arena.publish import print_results, publish, run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import recording_path
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import Lock, parse_record, read_mapping, write_file
from lidarnaut.envs.measures import SUCCESS
from lidarnaut.envs.player import Recording, build_page
from lidarnaut.envs.processes import interrupts_held, stop_workers

FOLDER = Path("runs/demo")
CONFIG = Path(__file__).parents[1] / "configs" / "reach_crowd.yaml"
TRAINING = {
    "total_steps": 50_000,
    "num_envs": 64,
    "environment.num_workers": 2,
    "environment.world": "hall",
    "environment.people.number": [4, 14],
    "network.width": 16,
    "environment.reward.progress": 0.2,
    "environment.reward.collision": -1.0,
    "hyperparameters.n_steps": 32,
    "hyperparameters.batch_size": 512,
    "evaluation.every": 25_000,
    "evaluation.episodes": 32,
    "evaluation.references": ["pursuit", "dwb"],
    "evaluation.environment.people.number": 14,
}
"""Changes to the training configuration `reach_crowd.yaml`, for a short training."""
RIVAL = "pursuit"
"""Classic controller that the trained policy should beat in success rate."""


class Scene(NamedTuple):
    """Section of the demo's report: an evaluation of pretrained policies, and the replay of an episode."""

    folder: str
    title: str
    text: str
    settings: Settings


SCENES = (
    Scene(
        "people",
        "A shipped policy among people",
        "The shipped policy and classic controllers in halls not used in training, among people of whom half ignore "
        "the robot. The shipped policy may have been trained longer than yours, in halls and corridors.",
        Settings(
            id="lidarnaut/ReachCrowd-v0",
            policies=(RIVAL, "dwb", "crowd=ppo:pretrained/crowd"),
            worlds=("hall",),
            people=("14?attentive=0.5",),
            physics=("kinematic",),
            arguments={"world_size": (12.0, 12.0), "collision_monitor": True},
            episodes=6,
        ),
    ),
    Scene(
        "house",
        "Shipped explorers in an unknown house",
        "This house was not used in training. A learned frontier score (learned) and PPO that observes the planned "
        "path (twist) are compared with a baseline (nearest). Map and pose are estimated by Hector SLAM.",
        Settings(
            policies=("nearest", "learned=learned:pretrained/frontiers", "twist=ppo:pretrained/twist"),
            worlds=("turtlebot3_house",),
            physics=("kinematic",),
            episodes=3,
        ),
    ),
)


def demo(config: TrainingConfig, folder: Path, scenes: Sequence[Scene] = SCENES, jobs: int = 2) -> str:
    """Train a policy, evaluate pretrained policies, and write `report.html` to `folder`, which is replaced.

    Returns the path of the report, and the training result as a sentence.

    Raises:
        lidarnaut.envs.files.LockedError: if another process uses `folder`.
    """
    from lidarnaut.agents.training import train  # imports torch, which takes seconds

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    folder.parent.mkdir(parents=True, exist_ok=True)
    with Lock(folder.parent, f"lock-{folder.name}"):
        work = folder.with_name(f"{folder.name}.new")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        task, stages = config.environment.id.removeprefix("lidarnaut/"), len(scenes) + 1
        say(f"1/{stages} Train PPO in {task}, from an untrained network: {config.total_steps:,} steps")
        with running(scenes, work):
            evaluations = read_evaluations(train(config, run=work / "training"))
        draw_learning_curve(evaluations, f"PPO learns {task}", curve := work / "learning_curve.png")
        lesson = describe_learning(evaluations, task)
        caption = "Star and lines are the same test episodes, in worlds not used in training; the curve has its own."
        learned = lesson, Figure(curve.stem, curve.read_bytes(), caption, is_wide=True)
        sections = [Section("PPO learns to reach goals among people", learned)]
        for number, scene in enumerate(scenes, start=2):
            say(f"{number}/{stages} {scene.title}: {scene.settings.episodes} episodes of each policy")
            sections.append(show(scene, work, jobs, console))
        links = [[Cell(one.title), Cell("report", link=f"{one.folder}/report.html")] for one in scenes]
        sections.append(Section("All episodes", (Table(("", "curves, pairs, typical and worst episodes"), links),)))
        page = to_html(sections, title="Lidarnaut demo: trained and shipped policies")
        write_file(work / "report.html", page)
        shutil.rmtree(folder, ignore_errors=True)
        work.rename(folder)
        say("Done")
    return f"{folder / 'report.html'}: {lesson}"


@contextlib.contextmanager
def running(scenes: Sequence[Scene], work: Path) -> Iterator[None]:
    """Evaluate scenes in another process until the end of the `with` block."""
    with make_pool(1, None) as pool:
        with interrupts_held():
            pool.submit(_evaluate, scenes, work)
        yield
        stop_workers(pool)


def _evaluate(scenes: Sequence[Scene], work: Path) -> None:
    logging.getLogger("lidarnaut").setLevel(logging.ERROR)  # the main process prints these messages
    for scene in scenes:
        Evaluation(scene.settings, work / scene.folder).run(record=True)


def show(scene: Scene, work: Path, jobs: int, console: Console) -> Section:
    evaluation = Evaluation(scene.settings, work / scene.folder)
    run_with_progress(evaluation, jobs, console, record=True)
    publish(evaluation)
    print_results(evaluation, console)
    episodes, measures = Episodes(evaluation.rows(), evaluation.measures), evaluation.measures
    policy = episodes.policies[-1]
    typical, _ = episodes.typical_and_worst(policy)
    player = build_page([Recording.load(recording_path(evaluation.folder, typical))])
    where = f"Press Play: the episode of {short(policy)} with the median {measures.headline.label} of "
    where += f"{scene.settings.episodes}, seed {typical['seed']}."
    ranking = ranking_table(episodes.related(), (measures.headline, *(measures.reached or (SUCCESS,))))
    return Section(scene.title, (scene.text, where, Frame(player, scene.title), ranking))


def describe_learning(evaluations: Sequence[CurveRow], task: str) -> str:
    shares = [float(row["success"]) for row in evaluations if row["policy"] in LEARNED_NAMES]
    others = [row for row in evaluations if row["policy"] not in LEARNED_NAMES]
    rivals = ", ".join(f"{row['policy']} {float(row['success']):.0%}" for row in others)
    steps = int(evaluations[-1]["steps"])
    before, after = f"{shares[0]:.0%} of its goals at first", f"{shares[-1]:.0%} after {steps:,} steps"
    return f"In {task}, PPO reached {before}, {after} ({rivals})."


def main() -> None:
    try:
        config = parse_record(with_recipe(change(read_mapping(CONFIG), TRAINING))[0], str(CONFIG), TrainingConfig)
        print(demo(config, FOLDER))
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped; an earlier demo in {FOLDER} is unchanged\n")
        sys.exit(130)


if __name__ == "__main__":
    run_command(main)
