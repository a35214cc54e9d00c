"""Trainings of several learning algorithms on several tasks, and the page that compares them, `algorithms.md`.

Statistics: Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (2021).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Picture

from lidarnaut.agents.config import CONFIGURATIONS, merge
from lidarnaut.agents.curves import LEARNED_NAMES, curve_of, read_evaluations, result_of, scores_of
from lidarnaut.agents.seeds import Member, processor_time, read_members
from lidarnaut.agents.statistics import Estimate, estimate, score
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_env
from lidarnaut.baselines.policy import GROUND_TRUTH
from lidarnaut.benchmarks.arena.page import Cell, Figure, Section, Table, write_markdown
from lidarnaut.benchmarks.arena.plots import INK, LINES, MUTED, render
from lidarnaut.benchmarks.arena.trace import slug
from lidarnaut.envs.command_line import Count, run_command
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import read_mapping
from lidarnaut.envs.measures import Measure, headline_of

TEXT = """\
Scores of the algorithms of [`train.py`](../guides/training.md) after minutes of training on one core, compared with
classic policies. Tasks, training budgets, and simplifications relative to the registered environments are in
[`configs/algorithms.yaml`](../../configs/algorithms.yaml). Hyperparameters are the defaults of `train.py`, except that
with twist actions PPO and RecurrentPPO start from driving ahead at half speed. In ExploreFrontiers, PPO starts from the
rule `gain_over_cost` (`PPO_from_rule` in the configuration): compare its score with that rule, not with random.

```
python -m lidarnaut.benchmarks.algorithms --jobs 2     # finished runs are kept
```

A score is the mean of the task's headline measure over the test episodes of the best checkpoint, in worlds of the test
split; all policies run the same episodes. Values are interquartile means over seeds with 95 % bootstrap intervals over
seeds and episodes (Agarwal et al. 2021); with fewer than four seeds, the interquartile mean is the mean. An algorithm
is above or below another policy if the 95 % interval of the paired difference excludes 0.
"""
RANDOM, SHARE = "random", Measure("share", "normalised score (random 0, best classic 1)", "", True, digits=2)
DASHES = ("dashed", "dashdot", (0, (5.0, 1.2)), (0, (1.0, 1.2)))
Scores = Mapping[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class TaskResults:
    """Results of learning algorithms and classic (not learned) policies on one task."""

    name: str
    measure: Measure
    steps: Mapping[str, np.ndarray]
    """Training steps before each evaluation of a learned policy, by algorithm: shape (num_evaluations,)."""
    scores: Scores
    """Values of the task's ranking measure by algorithm: shape (num_evaluations, seeds, episodes), float64."""
    results: Scores
    """Values of the task's ranking measure by algorithm, of each seed's best checkpoint in the test episodes: shape
    (seeds, episodes), float64."""
    references: Scores
    """Values of the task's ranking measure by classic policy, including `random`, best first: shape (1, episodes),
    float64."""
    times: Mapping[str, float]
    """Mean processor time of a training run, by algorithm [s]."""

    @property
    def classic(self) -> str:
        """Name of the best classic policy without access to ground truth, if any."""
        return next((name for name in self.references if name != RANDOM and not name.endswith(GROUND_TRUTH)), "")

    @property
    def sign(self) -> float:
        return 1.0 if self.measure.higher_is_better else -1.0


def read_task(name: str, members: Sequence[Member]) -> TaskResults:
    runs = {member.run: read_evaluations(member.run) for member in members}
    env = make_env(members[0].config.environment, "test")  # type: ignore[union-attr]
    measure = headline_of(lidar_env_of(env).task.measures)
    env.close()
    sign = -1.0 if measure.higher_is_better else 1.0
    rows = [row for run in runs.values() for row in run if row["policy"] not in LEARNED_NAMES]
    found = {str(row["policy"]): scores_of(row)[None] for row in rows}
    references = dict(sorted(found.items(), key=lambda item: sign * item[1].mean()))
    steps, scores, results, times = dict[str, Any](), dict[str, Any](), dict[str, Any](), dict[str, float]()
    for algorithm, some in groupby(members, lambda member: str(member.config.algorithm)):
        own = [member.run for member in some]
        curves = [curve_of(runs[run]) for run in own]
        steps[algorithm] = np.array([row["steps"] for row in curves[0]])
        scores[algorithm] = np.array([[scores_of(row) for row in rows] for rows in zip(*curves, strict=True)])
        results[algorithm] = np.array([scores_of(result_of(runs[run]) or runs[run][-1]) for run in own])
        times[algorithm] = float(np.mean([processor_time(run) for run in own]))
    return TaskResults(name, measure, steps, scores, results, references, times)


def difference(task: TaskResults, algorithm: str, policy: str) -> Estimate:
    return score(task.results[algorithm] - task.references[policy])


def task_section(task: TaskResults) -> Section:
    sentences, lines, measure = list[str](), list[Sequence[Cell]](), task.measure
    for policy, words in ((RANDOM, "random"), (task.classic, f"the best classic policy, {task.classic}")):
        groups: dict[str, list[str]] = {"Above": [], "Not distinguishable from": [], "Below": []}
        for name in task.scores:
            low, high = sorted(task.sign * end for end in difference(task, name, policy)[1:3])
            groups["Above" if low > 0.0 else "Below" if high < 0.0 else "Not distinguishable from"].append(name)
        sentences += [f"{group} {words}: {', '.join(names)}." for group, names in groups.items() if names]
    for name in task.scores:
        others = [difference(task, name, policy) for policy in (RANDOM, task.classic)]
        gaps = [Cell.of(gap, measure, sign="+") for gap in others]
        seeds, steps, time = task.scores[name].shape[1], task.steps[name][-1], task.times[name]
        counts = [Cell(f"{count:,.0f}") for count in (seeds, steps, time)]
        lines.append((Cell(name), Cell.of(score(task.results[name], is_widened=True), measure), *gaps, *counts))
    for name, scores in task.references.items():
        lines.append((Cell(name), Cell.of(score(scores, is_widened=True), measure), *[Cell("")] * 5))
    head = ("", measure.title, "vs. random", f"vs. {task.classic}", "seeds", "steps", "processor time s")
    caption = f"{measure.title} over training steps in validation episodes, with 95 % intervals; lines: test episodes"
    picture = Figure(slug(task.name), render(draw_task, task), caption)
    return Section(task.name, (" ".join(sentences), picture, Table(head, lines, is_open=True)))


def draw_task(task: TaskResults) -> Picture:
    figure, scale = Picture(figsize=(6.6, 3.6)), task.measure.scale
    axes = figure.subplots()
    for color, (name, scores) in zip(cycle(LINES), task.scores.items()):
        middle, low, high = np.array([score(one, is_widened=True)[:3] for one in scores]).T * scale
        axes.fill_between(task.steps[name] / 1000, low, high, color=color, alpha=0.15, linewidth=0)
        axes.plot(task.steps[name] / 1000, middle, color=color, marker=".", label=f"{name}, {task.times[name]:.0f} s")
    references = sorted(task.references.items(), key=lambda item: item[0] == RANDOM)
    for dash, (name, scores) in zip(cycle(DASHES), references):
        if name == RANDOM:  # far below the others
            axes.set_ylim(axes.get_ylim())
        level = scores.mean() * scale
        color = MUTED if name == RANDOM else INK
        axes.axhline(level, color=color, linestyle=dash, linewidth=1.2, label=f"{name}, {level:.1f}")
    axes.set_ylim(min(axes.get_ylim()[0], axes.get_ylim()[1] - 0.1 * scale))  # no magnified noise near 100 %
    axes.set(xlabel="thousand steps", ylabel=task.measure.title, title=task.name)
    figure.legend(loc="outside right center")
    return figure


def overview(tasks: Sequence[TaskResults]) -> Section:
    """Return a page section with scores over all tasks, scaled to 0 for `random` and 1 for the best classic policy."""
    strata: dict[str, list[np.ndarray]] = {}
    for task in tasks:
        levels = {name: float(scores.mean()) for name, scores in task.references.items()}
        none, one = (levels.get(name, 0.0) for name in (RANDOM, task.classic))
        for name, scores in task.results.items() if task.sign * (one - none) > 0.0 else ():
            strata.setdefault(name, []).append((scores.mean(axis=1) - none) / (one - none))
    lines = [
        (Cell(name), Cell.of(estimate(some), SHARE), Cell(str(len(some))), Cell(str(sum(map(len, some)))))
        for name, some in strata.items()
    ]
    text = "Interquartile means over seeds and supported tasks, with stratified bootstrap intervals."
    return Section("At a glance", (text, Table(("", SHARE.label, "tasks", "training runs"), lines, is_open=True)))


def configurations(plan: Path) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield the configurations of all trainings, with the names of task and algorithm.

    `plan`: YAML file with settings for all (`base`), by task, and by algorithm. Key `algorithms` of a task lists its
    algorithms; the first also measures the reference policies.
    """
    data = read_mapping(plan)
    for task, settings in data["tasks"].items():
        names = settings.pop("algorithms")
        for name in names:
            config = merge(merge(data["base"], settings), {"experiment": task, **data["algorithms"][name]})
            yield task, name, config if name == names[0] else merge(config, {"evaluation": {"references": []}})


def main(
    plan: Path = CONFIGURATIONS / "algorithms.yaml",
    *,
    jobs: Count = 1,
    out: Path = Path("runs/algorithms"),
    docs: Path = Path("docs/results"),
) -> None:
    """Train the algorithms on the tasks, and write the comparison `algorithms.md`, with figures in `algorithms/`.

    Args:
        plan: YAML file with the settings of tasks and algorithms.
        jobs: number of parallel trainings.
        out: folder of the runs. Unfinished runs go on.
        docs: output folder.
    """
    tasks = list[TaskResults]()
    for name, some in groupby(configurations(plan), lambda one: one[0]):
        folders = [train(config, run=out / name / algorithm, jobs=jobs) for _, algorithm, config in some]
        tasks.append(read_task(name, [member for folder in folders for member in read_members(folder)]))
    sections = [overview(tasks), *map(task_section, tasks)]
    write_markdown("Algorithms", TEXT, sections, docs / "algorithms.md", docs / "algorithms")


if __name__ == "__main__":
    run_command(main)
