"""Trainings of all recipes: learning curves, best checkpoints, and classic policies in `recipes.md`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lidarnaut.agents.config import RECIPES
from lidarnaut.agents.curves import TEST, Row, read_evaluations
from lidarnaut.agents.seeds import Member, read_members
from lidarnaut.agents.training import train
from lidarnaut.benchmarks.algorithms import read_task, task_section
from lidarnaut.benchmarks.arena.page import Cell, Markdown, Section, Table, write_markdown
from lidarnaut.envs.command_line import Count, run_command
from lidarnaut.envs.files import explain_unknown, read_bytes, read_mapping, write_file

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
the test episodes, unused by training and by the choice of a checkpoint: the best checkpoint of each seed, and classic
policies. Times are processor times of the main process.
"""

MISSING = "Not measured yet."


def main(
    ids: tuple[str, ...] = (),
    *,
    seeds: Count = 3,
    jobs: Count = 1,
    out: Path = Path("runs/recipes"),
    docs: Path = Path("docs/results"),
    test_episodes: Count | None = None,
) -> None:
    """Train recipes, and write the results of their best checkpoints to `recipes.md` and to a JSON file per id.

    Recipes without finished runs in `out` keep their sections of the page.

    Args:
        ids: names of recipes such as `ReachCrowd-v0`; none for all.
        seeds: number of trainings of each recipe.
        jobs: number of parallel trainings.
        out: folder of the runs. Unfinished runs go on.
        docs: output folder.
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
        if name in (ids or RECIPES):
            train(data, run=out / name, jobs=jobs)
        members = read_members(out / name)
        results = ((member.config.seed, row) for member in members for row in read_evaluations(member.run))
        tables[name] = rows = [{"seed": seed, **row} for seed, row in results if row.get("split") == TEST]
        sections.append(_section(name, members, rows) if rows or name not in kept else Section(name, (kept[name],)))
    write_markdown("Recipes", TEXT, sections, page, docs / "recipes")
    for name, rows in tables.items():
        if rows:
            write_file(docs / "recipes" / f"{name}.json", json.dumps(rows, indent=1))


def _section(name: str, members: Sequence[Member], rows: Sequence[Row]) -> Section:
    about = [line[2:] for line in read_bytes(RECIPES[name]).decode().splitlines() if line.startswith("# ")]
    if not rows:
        return Section(name, (" ".join(about), MISSING))
    return Section(name, (" ".join([*about, *_times(rows)]), *task_section(read_task(name, members)).parts))


def _times(rows: Sequence[Row]) -> list[str]:
    """Return a sentence with mean times to 95 % coverage, if the task measures them."""
    times: dict[str, list[str]] = {}
    for row in rows:
        if "time_to_95" in row:
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
