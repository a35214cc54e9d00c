"""The measures that the arena reports, in the order in which it reports them."""

import math
from dataclasses import dataclass

from benchmarks.arena.statistics import Estimate


@dataclass(frozen=True, slots=True)
class Measure:
    """How a number of an episode is named, read and printed."""

    name: str
    """Key in `summary.json`."""
    label: str
    unit: str
    higher_is_better: bool | None
    """None where neither is better by itself."""
    digits: int = 1
    """Decimals in tables."""
    scale: float = 1.0
    """Factor from the SI unit of the data to `unit`."""
    is_share: bool = False
    """Whether it is 0 or 1, so that its mean is a share."""
    limit: str = ""
    """Column that counts where the mark was never reached; empty where there is no mark."""

    @property
    def column(self) -> str:
        """Name of the column of `episodes.csv` that it is computed from."""
        return "success" if self.name == "success_rate" else self.name

    @property
    def title(self) -> str:
        """Label and unit, the heading of a column."""
        return f"{self.label} {self.unit}".strip()

    def text(self, value: float, sign: str = "") -> str:
        """Return the value in `unit`, rounded for a table; `sign="+"` marks it as a difference."""
        rounded = float(f"{value * self.scale:.{self.digits}f}") + 0.0  # no negative zero
        return f"{rounded:{sign}.{self.digits}f}"

    def texts(self, estimate: Estimate, sign: str = "") -> tuple[str, str]:
        """Return an estimate and what to print small beside it.

        That is its interval, ("41", "35 to 47"), of which some ends may be lower bounds, ("> 310 s", "250 to > 320");
        how many episodes got to the mark where all of it is a lower bound, ("> 310 s", "1 of 8"); and the limit that
        the episodes count as where none did, ("never", "> 300 s"); ("> 6.0", "never") for what has no limit of its own.
        """
        numbers = (self.text(value, sign) for value in estimate[:3])
        middle, low, high = (f"> {text}" if bound else text for text, bound in zip(numbers, estimate.is_bound))
        if estimate.is_bound[0]:
            middle = f"{middle} {self.unit}".strip()
        if estimate.never == estimate.n:
            return ("never", middle) if self.limit else (middle, "never")
        return middle, f"{estimate.n - estimate.never} of {estimate.n}" if estimate.is_bound[1] else f"{low} to {high}"


MEASURES = (
    Measure("explored_fraction", "explored", "%", True, 1, 100.0),
    Measure("time_to_90", "time to 90 %", "s", False, 0, limit="time_limit"),
    Measure("time_to_95", "time to 95 %", "s", False, 0, limit="time_limit"),
    Measure("time_to_99", "time to 99 %", "s", False, 0, limit="time_limit"),
    Measure("distance_to_95", "distance to 95 %", "m", False, limit="distance_limit"),
    Measure("area_under_curve", "area under curve", "%", True, 1, 100.0),
    Measure("path_length", "path", "m", None),
    Measure("collisions", "collisions", "", False),
    Measure("position_rmse", "position error", "cm", False, 1, 100.0),
    Measure("heading_rmse", "heading error", "deg", False, 2, math.degrees(1.0)),
    Measure("map_iou", "map IoU", "%", True, 1, 100.0),
    Measure("decision_ms", "decision", "ms", False, 2),
    Measure("success_rate", "success", "%", True, 0, 100.0, is_share=True),
)
RELATIVE = (
    Measure("relative_time", "time to 95 %, relative", "", False, 2, limit="relative_time_limit"),
    Measure("relative_distance", "distance to 95 %, relative", "", False, 2, limit="relative_distance_limit"),
)
"""Shares of what the reference needed from the same start (`benchmarks.arena.pairs.relate`): seconds and metres in a
maze and in a warehouse are not of a kind, these are."""
REACHED = Measure("reached_95", "95 % reached", "%", True, 0, 100.0, is_share=True)
BY_NAME = {measure.name: measure for measure in (*MEASURES, *RELATIVE, REACHED)}
