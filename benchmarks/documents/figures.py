import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

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

    def row(self) -> dict[str, str]:
        """Return a row of the terminal table."""
        better = ""
        if self.document is not None:
            lower, higher = sorted((self.median, self.document))
            better = "yes" if self.median == (lower if self.best == "least" else higher) else "no"
        return {
            "item": self.item,
            "unit": self.unit,
            "document": _number(self.document),
            "here (median)": _number(self.median),
            "worst": _number(self.worst) if len(self.runs) > 1 else "",
            "runs": str(len(self.runs)),
            "better": better,
        }


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


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:,.3g}" if math.isfinite(value) else "not reached"
