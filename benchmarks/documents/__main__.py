"""Experiments of the four documents: `python -m lidarnaut.benchmarks.documents NAME`; see `docs/documents`."""

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from lidarnaut.benchmarks.documents.figures import Figure, table
from lidarnaut.envs.command_line import Count, make_console, run_command
from lidarnaut.envs.files import write_file

Name = Literal["robot_vacuum", "pi_mouse", "warehouse_agv", "ekf_fusion"]


@dataclass(frozen=True)
class Command:
    """Command-line options of the experiments."""

    name: Annotated[Name, tyro.conf.Positional]
    """Document: TinySLAM robot vacuum, RRT exploration on a Pi Mouse, warehouse AGV, or EKF fusion."""
    json: Path | None = None
    """Also write the figures to this JSON file, as a list of records {item, unit, document, here, better}."""
    pictures: Path | None = None
    """Folder for the pictures; default: runs/documents/NAME."""
    runs: Count | None = None
    """Number of runs per experiment; default: as in the documentation."""
    jobs: Count = 2
    """Number of processes."""
    quick: bool = False
    """Run a shortened experiment, whose figures are not comparable."""


def main(command: Command) -> list[Figure]:
    """Run the experiment of a document; print its figures beside those of the document, and draw its pictures."""
    experiment = importlib.import_module(f"lidarnaut.benchmarks.documents.{command.name}")
    if command.json is not None and command.json.is_dir():
        raise ValueError(f"--json {command.json} is a folder; give a file")
    pictures = command.pictures or Path("runs/documents") / command.name
    for path in (pictures, command.json and command.json.parent):
        if path is not None:
            path.mkdir(parents=True, exist_ok=True)
    figures: list[Figure] = experiment.run(pictures, command.runs, command.jobs, command.quick)
    make_console().print(table(figures))
    if command.json is not None:
        rows = [row for figure in figures for row in figure.rows()]
        write_file(command.json, json.dumps(rows, indent=1) + "\n")
    return figures


if __name__ == "__main__":
    run_command(main, options=Command)
