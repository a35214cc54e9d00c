"""Demo: train a policy to reach goals among people, evaluate pretrained policies, and write a report."""

import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import LEARNED_NAMES, draw_learning_curve, read_evaluations
from lidarnaut.agents.curves import Row as CurveRow
from lidarnaut.agents.policy_names import short
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.leaderboard import ranking_table
from lidarnaut.benchmarks.arena.page import Cell, Figure, Frame, Section, Table, to_html
from lidarnaut.benchmarks.arena.publish import print_results, publish, run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import recording_path
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import parse_record, read_mapping, read_record, write_file
from lidarnaut.envs.measures import SUCCESS
from lidarnaut.envs.player import Recording, build_page

FOLDER, CONFIGS = Path("runs/demo"), Path(__file__).parents[1] / "configs"


class Scene(NamedTuple):
    """Section of the report: an evaluation of `configs/experiments/demo_NAME.yaml`, and the replay of an episode."""

    name: str
    title: str
    text: str


SCENES = (
    Scene(
        "people",
        "A shipped policy among people",
        "The shipped policy and classic controllers in halls not used in training, among people of whom half ignore "
        "the robot. The shipped policy may have been trained longer than yours, in halls and corridors.",
    ),
    Scene(
        "house",
        "Shipped explorers in an unknown house",
        "This house was not used in training. A learned frontier score (learned) and PPO that observes the planned "
        "path (twist) are compared with a baseline (nearest). Map and pose are estimated by Hector SLAM.",
    ),
)


def demo(config: TrainingConfig, scenes: Sequence[tuple[Scene, Settings]], folder: Path, jobs: int = 2) -> str:
    """Train a policy, evaluate pretrained policies, and write `report.html` to `folder`, which is replaced.

    Returns the path of the report, and the training result as a sentence.
    """
    from lidarnaut.agents.training import train  # imports torch, which takes seconds

    console, began = Console(stderr=True), time.monotonic()

    def say(text: str) -> None:
        console.print(f"[bold]{text}[/bold] [dim](after {time.monotonic() - began:.0f} s)[/dim]", highlight=False)

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    task, stages = config.environment.id.removeprefix("lidarnaut/"), len(scenes) + 1
    say(f"1/{stages} Train PPO in {task}, from an untrained network: {config.total_steps:,} steps")
    evaluations = read_evaluations(train(config, run=folder / "training"))
    draw_learning_curve(evaluations, f"PPO learns {task}", curve := folder / "learning_curve.png")
    lesson = describe_learning(evaluations, task)
    caption = "Star and lines are the same test episodes, in worlds not used in training; the curve has its own."
    learned = lesson, Figure(curve.stem, curve.read_bytes(), caption, is_wide=True)
    sections = [Section("PPO learns to reach goals among people", learned)]
    for number, (scene, settings) in enumerate(scenes, start=2):
        say(f"{number}/{stages} {scene.title}: {settings.episodes} episodes of each policy")
        sections.append(show(scene, Evaluation(settings, folder / scene.name), jobs, console))
    links = [[Cell(one.title), Cell("report", link=f"{one.name}/report.html")] for one, _ in scenes]
    sections.append(Section("All episodes", (Table(("", "curves, pairs, typical and worst episodes"), links),)))
    page = to_html(sections, title="Lidarnaut demo: trained and shipped policies")
    write_file(folder / "report.html", page)
    say("Done")
    return f"{folder / 'report.html'}: {lesson}"


def show(scene: Scene, evaluation: Evaluation, jobs: int, console: Console) -> Section:
    run_with_progress(evaluation, jobs, console, record=True)
    publish(evaluation)
    print_results(evaluation, console)
    episodes, measures = Episodes(evaluation.rows(), evaluation.measures), evaluation.measures
    policy = episodes.policies[-1]
    typical, _ = episodes.typical_and_worst(policy)
    player = build_page([Recording.load(recording_path(evaluation.folder, typical))])
    where = f"Press Play: the episode of {short(policy)} with the median {measures.headline.label} of "
    where += f"{evaluation.settings.episodes}, seed {typical['seed']}."
    ranking = ranking_table(episodes, (SUCCESS, measures.decisive))
    return Section(scene.title, (scene.text, where, Frame(player, scene.title), ranking))


def describe_learning(evaluations: Sequence[CurveRow], task: str) -> str:
    shares = [float(row["success"]) for row in evaluations if row["policy"] in LEARNED_NAMES]
    others = [row for row in evaluations if row["policy"] not in LEARNED_NAMES]
    rivals = ", ".join(f"{row['policy']} {float(row['success']):.0%}" for row in others)
    steps = int(evaluations[-1]["steps"])
    before, after = f"{shares[0]:.0%} of its goals at first", f"{shares[-1]:.0%} after {steps:,} steps"
    return f"In {task}, PPO reached {before}, {after} ({rivals})."


def read_configs() -> tuple[TrainingConfig, list[tuple[Scene, Settings]]]:
    """Return the configuration of the training, and the scenes with the settings of their evaluations."""
    scenes = [(scene, read_record(CONFIGS / "experiments" / f"demo_{scene.name}.yaml", Settings)) for scene in SCENES]
    path = CONFIGS / "demo.yaml"
    return parse_record(with_recipe(read_mapping(path))[0], str(path), TrainingConfig), scenes


def main() -> None:
    try:
        print(demo(*read_configs(), FOLDER))
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    run_command(main)
