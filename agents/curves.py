"""Learning curves as pictures."""

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.baselines.explorer import GROUND_TRUTH
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import MAX_JSON_BYTES, printable, read_bytes, read_record, write_file

Row = dict[str, int | float | str]
"""A line of `evaluations.csv`."""
LEARNED = "learned"
"""Policy of the rows that tell how well the trained one does."""
LEARNED_NAMES = LEARNED, LEARNED + GROUND_TRUTH
"""The same without ground truth, and with it."""
SCORES = "scores"
"""Column with the headline measure of each episode, in a text."""


def read_evaluations(run: Path) -> list[Row]:
    """Read `evaluations.csv` of a run folder, numbers except in `policy` and `scores`; ValueError if it is damaged."""
    kinds: dict[str, type] = {"policy": str, SCORES: str, "steps": int}
    path = run / "evaluations.csv"
    try:
        rows = csv.DictReader(io.StringIO(read_bytes(path, MAX_JSON_BYTES).decode(), newline=""))
        found = [{key: kinds.get(key, float)(value) for key, value in row.items()} for row in rows]
        check_rows(found)
    except (ValueError, TypeError, csv.Error) as error:
        raise ValueError(f"{path}: no table of evaluations: {error}") from error
    if not found:
        raise ValueError(f"{path}: holds no evaluations")
    return found


def check_rows(rows: Sequence[Row]) -> None:
    """Raise a ValueError if one of the rows lacks a column that curves show, or holds no number there."""
    try:
        for row in rows:
            int(row["steps"]), str(row["policy"])
            numbers = [row[name] for name in ("progress", "success", headline_of_rows(rows))]
            np.array([*numbers, *str(row[SCORES]).split()], dtype=np.float64)
    except (KeyError, ValueError, OverflowError) as error:
        raise ValueError(f"evaluations have a damaged row: {type(error).__name__}: {error}") from error


def headline_of_rows(rows: Sequence[Row]) -> str:
    """Return the column of the headline measure: the one whose quartiles are there."""
    return next((name.removesuffix("_q25") for name in rows[0] if name.endswith("_q25")), "*_q25")


def draw_learning_curve(
    runs: Mapping[str, Sequence[Row]], title: str, path: Path, axis: str = "environment steps"
) -> None:
    """Draw how often goals are reached, or how much of the task is done, and the headline measure, over training steps.

    A line is the mean over episodes, with its 95 % interval as a band. What does not learn is a level line. `runs` are
    rows of `evaluations.csv` by the run's label, `axis` is what their column `steps` counts.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.4), dpi=120, layout="constrained")
    figure.suptitle(_plain(title))
    first = next(iter(runs.values()))
    headline, share = headline_of_rows(first), "success" if "spl" in first[0] else "progress"
    for axes, measure in zip(figure.subplots(1, 2), (share, headline), strict=True):
        for number, (name, run) in enumerate(runs.items()):
            learned = [row for row in run if row["policy"] in LEARNED_NAMES]
            steps = [int(row["steps"]) for row in learned]
            means = np.array([float(row[measure]) for row in learned])
            axes.plot(steps, means, color=f"C{number}", marker=".", label=_plain(name))
            if measure != "progress":
                errors = np.array([_error_of_mean(row, measure) for row in learned])
                low, high = means - 1.96 * errors, means + 1.96 * errors
                axes.fill_between(steps, low, high, color=f"C{number}", alpha=0.15, linewidth=0)
        # All runs of one experiment measure the references on the same episodes.
        references = [row for row in first if row["policy"] not in LEARNED_NAMES]
        for row, style in zip(references, itertools.cycle(("--", ":", "-.", "-"))):
            axes.axhline(float(row[measure]), color="0.35", linestyle=style, label=_plain(row["policy"]))
        axes.set_xlabel(axis)
        names = {"progress": "share of the task that is done", "success": "share of goals reached"}
        names |= {"time_spl": "success times ideal time over time"}
        axes.set_ylabel(names.get(measure, measure.replace("_", " ")))
        axes.set_ylim(bottom=0, top=1 if measure == share else None)
        axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5)
    _save(figure, path)


def _plain(text: object) -> str:
    """Return a text that Matplotlib shows as it is: no control characters, and no mathematics."""
    return printable(text).replace("$", r"\$")


def _save(figure: Any, path: Path) -> None:
    """Write a figure as PNG."""
    picture = io.BytesIO()
    figure.savefig(picture)
    write_file(path, picture.getvalue())


def _error_of_mean(row: Row, measure: str) -> float:
    """Return the standard error of the mean over the episodes of an evaluation: of `success`, or of the headline."""
    scores = np.array(str(row[SCORES]).split(), dtype=np.float64)
    share = float(row["success"])
    spread = np.sqrt(share * (1.0 - share)) if measure == "success" else scores.std()
    return float(spread / np.sqrt(len(scores)))


def draw_sweep(curves: Mapping[str, np.ndarray], measure: str, title: str, path: Path) -> None:
    """Draw a measure over the steps of several trainings, shape (n, 4) by label: steps, mean, and a 95 % interval."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.8), dpi=120, layout="constrained")
    axes = figure.subplots()
    for number, (label, points) in enumerate(curves.items()):
        where, mean, low, high = points.T
        axes.plot(where, mean, color=f"C{number}", marker=".", label=_plain(label))
        axes.fill_between(where, low, high, color=f"C{number}", alpha=0.15, linewidth=0)
    axes.set(xlabel="steps", ylabel=_plain(measure.replace("_", " ")), title=_plain(title))
    axes.grid(alpha=0.3)
    axes.legend()
    _save(figure, path)


def main(runs: tyro.conf.Positional[tuple[Path, ...]], out: Path, title: str = "") -> None:
    """Draw the curves of several run folders of one experiment into one picture, the PNG `out`."""
    curves = {}
    for run in runs:
        own, rows = read_record(run / "config.yaml", TrainingConfig), read_evaluations(run)
        curves[f"{own.algorithm}, seed {own.seed}{str(rows[-1]['policy']).removeprefix(LEARNED)}"] = rows
    draw_learning_curve(curves, title, out)


if __name__ == "__main__":
    run_command(main)
