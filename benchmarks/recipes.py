"""Trainings of all recipes: learning curves, best and last checkpoints, and classic policies in `recipes.md`."""

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.agents.algorithms import build_policy
from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.config import RECIPES
from lidarnaut.agents.curves import TEST, Row, read_evaluations, scores_of
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.run_folder import find_checkpoint
from lidarnaut.agents.seeds import Member, read_members
from lidarnaut.agents.statistics import score
from lidarnaut.agents.training import train as train_policy
from lidarnaut.benchmarks.algorithms import read_task, task_section
from lidarnaut.benchmarks.arena.page import Cell, Markdown, Section, Table, write_markdown
from lidarnaut.envs.command_line import Count, run_command
from lidarnaut.envs.files import explain_unknown, read_bytes, read_json, read_mapping, write_file

TEXT = """\
`train.py --environment.id ID` starts from the recipe of the id, a file in `configs/recipes/`. Exploration of a given
world, such as `ExploreHouse-v0`, has the recipe of `Explore-v0`.
[Train a policy](../guides/training.md) explains how a configuration changes it. The table and the sections below are
made from the files and from their runs:

```sh
python -m lidarnaut.benchmarks.recipes --jobs 2             # all; finished runs are kept
python -m lidarnaut.benchmarks.recipes --ids ReachCrowd-v0 --test-episodes 300
```

Curves are means over seeds in validation episodes, with 95 % bootstrap intervals over seeds and episodes. Tables show
the test episodes, unused by training and by the choice of a checkpoint: the best checkpoint of each seed, the last one,
and classic policies. Times are processor times of the main process.
"""

MISSING = "Not measured yet."


def main(
    ids: tuple[str, ...] = (),
    *,
    seeds: Count = 3,
    jobs: Count = 1,
    out: Path = Path("runs/recipes"),
    docs: Path = Path("docs/results"),
    train: bool = True,
    test_episodes: Count | None = None,
) -> None:
    """Train recipes, measure their best and last checkpoints, and write `recipes.md` and a JSON file per id.

    Recipes without finished runs in `out` keep their sections of the page.

    Args:
        ids: names of recipes such as `ReachCrowd-v0`; none for all.
        seeds: number of trainings of each recipe.
        jobs: number of parallel trainings.
        out: folder of the runs. Unfinished runs go on.
        docs: output folder.
        train: whether to train; otherwise, only write results of finished trainings.
        test_episodes: number of test episodes; by default that of the recipe. More take longer, and narrow intervals.

    Raises:
        ValueError: if a recipe is unknown, or trainings fail.
    """
    if unknown := [name for name in ids if name not in RECIPES]:
        raise ValueError(f"unknown recipe {explain_unknown(unknown[0], RECIPES)}")
    sections, tables = [Section("Recipes", (_overview(),))], dict[str, list[Row]]()
    page = docs / "recipes.md"
    parts = read_bytes(page).decode().split("\n## ")[1:] if page.exists() else []
    found = (part.partition("\n\n") for part in parts if MISSING not in part)
    kept = {name: Markdown(text.strip()) for name, _, text in found}  # sections with results
    for name in RECIPES:
        data: dict[str, Any] = {"experiment": name, "environment": {"id": f"lidarnaut/{name}"}}
        data["seeds"] = list(range(seeds))
        data |= {"evaluation": {"test_episodes": test_episodes}} if test_episodes else {}
        if train and name in (ids or RECIPES):
            train_policy(data, run=out / name, jobs=jobs)
        members = read_members(out / name)
        tables[name] = rows = [row for member in members for row in _results(member)]
        sections.append(_section(name, members, rows) if rows or name not in kept else Section(name, (kept[name],)))
    write_markdown("Recipes", TEXT, sections, page, docs / "recipes")
    for name, rows in tables.items():
        if rows:
            write_file(docs / "recipes" / f"{name}.json", json.dumps(rows, indent=1))


def _results(member: Member) -> list[Row]:
    """Return the results of a run in the test episodes: classic policies, best checkpoint and last one."""
    rows = [{"seed": member.config.seed, **row} for row in read_evaluations(member.run) if row.get("split") == TEST]
    rows[-1] |= {"checkpoint": "best"}
    last, kept = find_checkpoint(member.run), member.run / "last.json"
    if not kept.exists() or read_json(kept)["steps"] != int(last.name[5:]):
        with contextlib.closing(Evaluator(member.config)) as evaluator:  # type: ignore[arg-type]
            policy = build_policy(load_checkpoint(last, policy_only=True), last)
            row = {"steps": int(last.name[5:]), **evaluator.policy(policy, TEST)}
        write_file(kept, json.dumps(row))
    return [*rows, {"seed": member.config.seed, **read_json(kept), "checkpoint": "last"}]


def _section(name: str, members: Sequence[Member], rows: Sequence[Row]) -> Section:
    about = [line[2:] for line in read_bytes(RECIPES[name]).decode().splitlines() if line.startswith("# ")]
    if not rows:
        return Section(name, (" ".join(about), MISSING))
    task = read_task(name, members)
    section, last = task_section(task), [scores_of(row) for row in rows if row.get("checkpoint") == "last"]
    *parts, table = section.parts
    if isinstance(table, Table):
        ends = Cell("last checkpoint"), Cell.of(score(np.array(last), is_widened=True), task.measure), *[Cell("")] * 5
        table = table._replace(lines=[*table.lines, ends])
    return Section(name, (" ".join([*about, *_times(rows)]), *parts, table))


def _times(rows: Sequence[Row]) -> list[str]:
    """Return a sentence with mean times to 95 % coverage, if the task measures them."""
    times: dict[str, list[str]] = {}
    for row in rows:
        if row.get("checkpoint") != "last" and "time_to_95" in row:
            times.setdefault(str(row["policy"]), []).append(f"{float(row['time_to_95']):.0f}")
    policies = "; ".join(f"{name} {', '.join(some)} s" for name, some in times.items())
    return [f"Mean time to 95 % (time limit, if never reached), by seed: {policies}."] if times else []


def _overview() -> Table:
    rows = []
    for name, path in RECIPES.items():
        recipe = read_mapping(path)
        observed = ", ".join(recipe["environment"].get("observations", ["of the id"]))
        texts = name, recipe["algorithm"], f"{recipe['total_steps']:,}", str(recipe["num_envs"]), observed
        rows.append([Cell(text) for text in texts])
    return Table(("recipe", "algorithm", "steps", "sub-environments", "observations"), rows, words=(1, 4), is_open=True)


if __name__ == "__main__":
    run_command(main)
