"""Times to 95 % over those of a reference from the same starts: `python -m benchmarks.time_ratios FOLDER`.

FOLDER is what `evaluate.py --out` wrote. Geometric means over all pairs, whatever their physics and SLAM; a time that
was not reached counts as the time limit, one of less than a second as a second.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.arena.statistics import paired_ratio, probability_of_improvement

LEAST_TIME = 1.0
"""Times below count as this one: the first scan may show a small world as a whole [s]."""


def paired_times(rows: Sequence[Mapping[str, str]], policy: str, reference: str) -> tuple[list[np.ndarray], ...]:
    """Return the times of a policy and of a reference [s], and where they reached the target, by world and SLAM.

    Raises:
        ValueError: if they have no start in common.
    """
    found: dict[str, dict[tuple[str, ...], tuple[float, bool]]] = {policy: {}, reference: {}}
    for row in rows:
        if row["policy"] in found:
            time = float(row["time_to_95"])
            reached = math.isfinite(time)
            start = tuple(row[key] for key in ("world", "robot", "physics", "slam", "seed"))
            value = max(time if reached else float(row["time_limit"]), LEAST_TIME)
            found[row["policy"]][start] = value, reached
    common = sorted(found[policy].keys() & found[reference].keys())
    if not common:
        raise ValueError(f"{policy!r} and {reference!r} have no start in common")
    strata: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for start in common:
        strata.setdefault(start[:-1], []).append(start)

    def column(name: str, part: int) -> list[np.ndarray]:
        return [np.array([found[name][start][part] for start in starts]) for starts in strata.values()]

    return column(policy, 0), column(reference, 0), column(policy, 1), column(reference, 1)


def main(folder: Annotated[Path, tyro.conf.Positional], reference: str = "gain_over_cost") -> None:
    """Print the table.

    Args:
        folder: of an evaluation.
        reference: name of the policy that the others are compared with.
    """
    with open(folder / "episodes.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    table = Table("policy", "pairs", f"time / {reference}'s", "faster", "reached", f"{reference} reached")
    for policy in dict.fromkeys(row["policy"] for row in rows):
        if policy != reference:
            own, other, reached, other_reached = paired_times(rows, policy, reference)
            ratio, better = paired_ratio(own, other), probability_of_improvement(own, other, higher_is_better=False)
            cells = [f"{e.iqm:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in (ratio, better)]
            counts = [str(int(np.concatenate(flags).sum())) for flags in (reached, other_reached)]
            table.add_row(policy, str(ratio.n), *cells, *counts)
    Console(width=140).print(table)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
