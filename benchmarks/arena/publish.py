"""Write down what an evaluation found."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agents.files import write_file
from benchmarks.arena.plots import draw_world
from benchmarks.arena.records import Row
from benchmarks.arena.report import build_report
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.summary import Summary, summarise, to_json
from benchmarks.arena.theme import short
from benchmarks.arena.trace import load_traces, slug


def run_with_progress(evaluation: Evaluation, jobs: int, console: Console) -> list[Row]:
    """Run an evaluation behind a progress bar that shows the latest episode."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("[dim]{task.fields[latest]}"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("episodes", total=evaluation.total, completed=evaluation.done, latest="")

        def on_episode(row: Row) -> None:
            latest = f"{short(row['policy'])} in {row['world']}: {100 * row['explored_fraction']:.0f} %"
            progress.update(task, advance=1, latest=latest)

        return evaluation.run(jobs, on_episode)


def publish(rows: Sequence[Row], settings: Settings, folder: Path, **report: Any) -> Summary:
    """Write `summary.json`, the pictures and `report.html` into the folder of an evaluation.

    Args:
        rows: all episodes.
        settings: what was run.
        folder: of the evaluation; holds the traces.
        report: further arguments of `build_report`.
    """
    summary = summarise(rows)
    write_file(folder / "summary.json", json.dumps(to_json(summary), indent=1) + "\n")
    pictures = {world: draw_world(load_traces(folder, rows, world)) for world in settings.worlds}
    for world, drawn in pictures.items():
        write_file(folder / f"curves_{slug(world)}_time.png", drawn.over_time.light)
        write_file(folder / f"curves_{slug(world)}_distance.png", drawn.over_distance.light)
        write_file(folder / f"growth_{slug(world)}.png", drawn.growth.light)
        for policy, picture in drawn.maps.items():
            write_file(folder / f"map_{slug(world)}_{slug(policy)}.png", picture.light)
    write_file(folder / "report.html", build_report(rows, settings, pictures, **report))
    return summary
