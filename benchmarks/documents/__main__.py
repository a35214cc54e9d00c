"""Experiments of the four documents: `python -m lidarnaut.benchmarks.documents NAME`; see `docs/documents`."""

import importlib
from pathlib import Path
from typing import Annotated, Literal

import tyro

from lidarnaut.benchmarks.documents.figures import Figure
from lidarnaut.benchmarks.drives.recording import table
from lidarnaut.envs.command_line import Count, make_console, run_command

Name = Literal["robot_vacuum", "pi_mouse", "warehouse_agv", "ekf_fusion"]


def main(
    name: Annotated[Name, tyro.conf.Positional],
    *,
    pictures: Path | None = None,
    runs: Count | None = None,
    jobs: Count = 2,
    quick: bool = False,
) -> list[Figure]:
    """Run the experiment of a document; print its figures beside those of the document, and draw its pictures.

    Args:
        name: document: TinySLAM robot vacuum, RRT exploration on a Pi Mouse, warehouse AGV, or EKF fusion.
        pictures: folder for the pictures; default: runs/documents/NAME.
        runs: number of runs per experiment; default: as in the documentation.
        jobs: number of processes.
        quick: run a shortened experiment, whose figures are not comparable.
    """
    pictures = pictures or Path("runs/documents") / name
    pictures.mkdir(parents=True, exist_ok=True)
    experiment = importlib.import_module(f"lidarnaut.benchmarks.documents.{name}")
    figures: list[Figure] = experiment.run(pictures, runs, jobs, quick)
    make_console().print(table([figure.row() for figure in figures]), *getattr(experiment, "NOTES", ()))
    return figures


if __name__ == "__main__":
    run_command(main)
