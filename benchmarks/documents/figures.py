import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from rich.table import Table

MOST = "IoU", "goals reached", "explored share"
"""Words in the names of quantities whose highest values are the best."""


@dataclass(frozen=True, slots=True)
class Figure:
    """Measured quantity of an experiment, beside the value in the document."""

    item: str
    """Name of the quantity, without its unit."""
    unit: str
    runs: Sequence[float]
    """Measured value of each run; NaN or inf if the run did not reach it."""
    document: float | None = None
    """Value in the document; None if the document gives none."""
    best: Literal["least", "most"] = "least"
    """Which values are good: `least` for errors and times, `most` for shares and scores."""

    @property
    def median(self) -> float:
        return float(np.median(self._failures_last()))

    @property
    def worst(self) -> float:
        return float((np.max if self.best == "least" else np.min)(self._failures_last()))

    def _failures_last(self) -> np.ndarray:
        runs = np.array(self.runs, dtype=np.float64)
        return np.where(np.isnan(runs), math.inf if self.best == "least" else -math.inf, runs)

    def is_better(self, value: float) -> bool | None:
        """Return whether a value is at least as good as the document's; None if the document gives none."""
        if self.document is None:
            return None
        return value <= self.document if self.best == "least" else value >= self.document

    def rows(self) -> list[dict[str, Any]]:
        """Return records `{item, unit, document, here, better}`: the median, and the worst of several runs.

        `here` is None if the run did not reach the quantity.
        """
        values = {self.item: self.median}
        if len(self.runs) > 1:
            values = {f"{self.item}, median of {len(self.runs)}": self.median}
            values[f"{self.item}, worst of {len(self.runs)}"] = self.worst
        known = {"unit": self.unit, "document": self.document}
        return [
            {"item": item, **known, "here": value if math.isfinite(value) else None, "better": self.is_better(value)}
            for item, value in values.items()
        ]


def figures_of(runs: Sequence[Mapping[str, float]], name: str, documents: Mapping[str, float] = {}) -> list[Figure]:
    """Return a figure for each quantity of several runs, with keys such as `heading RMSE [deg]`.

    `name`: format of the item, with `{}` for the quantity. `documents`: values in the document, by key.
    """
    figures = []
    for key in runs[0]:
        item, _, unit = key.rstrip("]").partition(" [")
        best: Any = "most" if any(word in item for word in MOST) else "least"
        figures.append(Figure(name.format(item), unit, [run[key] for run in runs], documents.get(key), best))
    return figures


def table(figures: Sequence[Figure]) -> Table:
    """Return a terminal table of figures: document, median, worst, number of runs, and comparison."""
    made = Table("item", "unit", "document", "here (median)", "worst", "runs", "better")
    for one in figures:
        better = {None: "", True: "yes", False: "no"}[one.is_better(one.median)]
        values = [_number(one.document), _number(one.median), _number(one.worst) if len(one.runs) > 1 else ""]
        made.add_row(one.item, one.unit, *values, str(len(one.runs)), better)
    return made


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:,.3g}" if math.isfinite(value) else "not reached"
