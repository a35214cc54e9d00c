"""Tables of evaluations, and plots of learning curves."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lidarnaut.agents.statistics import score, success_rate
from lidarnaut.baselines.policy import GROUND_TRUTH
from lidarnaut.envs.files import MAX_JSON_BYTES, printable, read_bytes, write_file

Row = dict[str, int | float | str]
"""Row of the evaluation table `evaluations.csv`: value by column name."""
LEARNED = "learned"
LEARNED_NAMES = LEARNED, LEARNED + GROUND_TRUTH
"""Possible names of the trained policy in the evaluation table; the second marks observations with ground truth."""
SCORES = "scores"
"""Column with the headline (main) measure of each episode, as numbers separated by spaces."""
DASH = 4.0
"""Length of the dashes of reference policies [line widths]."""
HEADLINES = {"sct": "success weighted by completion time (SCT)", "spl": "success weighted by path length (SPL)"}
VALIDATION: Literal["validation"] = "validation"
TEST: Literal["test"] = "test"
"""Value of the column `split` for the result of the best checkpoint, which validation episodes have chosen."""


def read_evaluations(run: str | Path) -> list[Row]:
    """Read the evaluation table of a run folder; raise ValueError if empty or damaged."""
    kinds: dict[str, type] = {"policy": str, "split": str, SCORES: str, "steps": int}
    path = Path(run) / "evaluations.csv"
    try:
        rows = csv.DictReader(io.StringIO(read_bytes(path, MAX_JSON_BYTES).decode(), newline=""))
        found = [{key: kinds.get(key, float)(value) for key, value in row.items()} for row in rows]
        check_rows(found)
    except (ValueError, TypeError, csv.Error) as error:
        raise ValueError(f"{path}: not a table of evaluations: {error}") from error
    if not found:
        raise ValueError(f"{path}: holds no evaluations")
    return found


def check_rows(rows: Sequence[Row]) -> None:
    """Raise ValueError if a row of the evaluation table lacks a number that plots need."""
    try:
        for row in rows:
            int(row["steps"]), str(row["policy"])
            numbers = [row[name] for name in ("progress", "success", headline_of_rows(rows))]
            if not (scores_of(row).size and np.isfinite([*map(float, numbers), *scores_of(row)]).all()):
                raise ValueError("progress, success, headline measure and scores must be finite numbers")
    except (KeyError, ValueError, OverflowError) as error:
        raise ValueError(f"evaluations have a damaged row: {type(error).__name__}: {error}") from error


def curve_of(rows: Sequence[Row]) -> list[Row]:
    """Return the evaluations of the trained policy during its training."""
    return [row for row in rows if row["policy"] in LEARNED_NAMES and row.get("split") != TEST]


def result_of(rows: Sequence[Row]) -> Row | None:
    """Return the result of a training on the test episodes; in runs of earlier versions, the last evaluation."""
    learned = [row for row in rows if row["policy"] in LEARNED_NAMES]
    return learned[-1] if learned and learned[-1].get("split", TEST) == TEST else None


def scores_of(row: Row) -> np.ndarray:
    """Return the headline (main) measure of each episode of an evaluation, shape (episodes,), float64."""
    return np.array(str(row[SCORES]).split(), dtype=np.float64)


def interval_of(row: Row, measure: str) -> tuple[float, float]:
    """Return the 95 % interval of the success rate (Wilson) or of the headline measure (bootstrap) of an evaluation."""
    scores = scores_of(row)
    if measure == "success":
        return success_rate([np.arange(len(scores)) < round(float(row[measure]) * len(scores))])[1:3]
    return score(scores[None], is_widened=True)[1:3]


def headline_of_rows(rows: Sequence[Row]) -> str:
    """Return the name of the headline (main) measure in an evaluation table, recognized by its quartile column."""
    return next((name.removesuffix("_q25") for name in rows[0] if name.endswith("_q25")), "*_q25")


def draw_learning_curve(rows: Sequence[Row], title: str, path: Path, axis: str = "environment steps") -> None:
    """Plot success rate or task progress, and the headline (main) measure, over training steps.

    Curves are means over the episodes of an evaluation, with 95 % intervals except for progress. A star is the result
    of the best checkpoint in the test episodes, horizontal lines are reference policies. `rows`: evaluations of a run.
    `axis`: label of the x-axis.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter, MaxNLocator

    figure = Figure(figsize=(10, 4.4), dpi=120, layout="constrained")
    figure.suptitle(_plain(title))
    headline, share = headline_of_rows(rows), "success" if "spl" in rows[0] else "progress"
    learned, result, name = curve_of(rows), result_of(rows), _plain(rows[-1]["policy"])
    steps = [int(row["steps"]) for row in learned]
    for axes, measure in zip(figure.subplots(1, 2), (share, headline), strict=True):
        axes.plot(steps, [float(row[measure]) for row in learned], "C0o-", markersize=4, zorder=3, label=name)
        if measure != "progress":
            low, high = np.array([interval_of(row, measure) for row in learned]).T
            axes.fill_between(steps, low, high, color="C0", alpha=0.15, linewidth=2 * (len(steps) == 1))
        if result is not None and result.get("split") == TEST:
            label = f"{name}, best checkpoint in test episodes"
            axes.plot(int(result["steps"]), float(result[measure]), "C0*", markersize=15, fillstyle="none", label=label)
        references = [row for row in rows if row["policy"] not in LEARNED_NAMES]
        for k, row in enumerate(references, 1):
            dashes = -k * DASH, (DASH, DASH * max(len(references) - 1, 1))  # those of equal lines alternate
            axes.axhline(float(row[measure]), color=f"C{k}", linestyle=dashes, label=_plain(row["policy"]))
        axes.set_xlim(left=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(6))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        names = {"progress": "completed share of the task", "success": "share of goals reached"}
        axes.set(xlabel=axis, ylabel=names.get(measure, HEADLINES.get(measure, measure.replace("_", " "))))
        low, high = axes.get_ylim()  # with a margin
        axes.set_ylim(min(low, 0.0), max(high, 1.0) if measure == share else high)
        axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, handlelength=4.0)
    _save(figure, path)


def _plain(text: object) -> str:
    return printable(text).replace("$", r"\$")


def _save(figure: Any, path: Path) -> None:
    picture = io.BytesIO()
    figure.savefig(picture)
    write_file(path, picture.getvalue())


def draw_seeds(points: np.ndarray, measure: str, title: str, path: Path) -> None:
    """Plot the mean of a measure over several trainings against steps, with its confidence band.

    `points`: array of shape (n, 4): steps, mean, lower and upper 95 % bound.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.8), dpi=120, layout="constrained")
    axes, (steps, mean, low, high) = figure.subplots(), points.T
    axes.plot(steps, mean, marker=".")
    axes.fill_between(steps, low, high, alpha=0.15, linewidth=0)
    axes.set(xlabel="steps", ylabel=_plain(HEADLINES.get(measure, measure.replace("_", " "))), title=_plain(title))
    axes.grid(alpha=0.3)
    _save(figure, path)
