"""Times to 95 % over those of a reference from the same starts: `python -m benchmarks.time_ratios FOLDER`.

FOLDER is what `evaluate.py --out` wrote. Geometric means over all pairs, whatever their physics and SLAM; a time that
was not reached counts as the time limit, one of less than a second as a second. `--groups` adds rows for what training
has seen and for what was held out from it, `--by` rows for each world, robot, physics or SLAM. With `oracle` among the
policies, the last column is the share of the oracle's gain on the reference that a policy gains (logarithms of times,
interquartile means).
"""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.table import Table

from agents.frontiers.tasks import HELD_OUT, TRAINING_WORLDS, is_held_out
from benchmarks.arena.pairs import bound_of
from benchmarks.arena.policies import is_bound
from benchmarks.arena.statistics import gap_closed, paired_ratio, probability_of_improvement
from envs.command_line import make_console, run_command
from envs.worlds import FAMILIES

LEAST_TIME = 1.0
"""Times below count as this one: the first scan may show a small world as a whole [s]."""
Row = Mapping[str, str]
GROUPS: dict[str, Callable[[Row], bool]] = {
    "all": lambda row: True,
    "library, training": lambda row: row["world"] in TRAINING_WORLDS,
    "library, held out": lambda row: row["world"] in HELD_OUT.worlds,
    "families, test seeds": lambda row: row["world"] in FAMILIES,
    "robots, held out": lambda row: row["robot"] in HELD_OUT.robots,
    "all that is held out": lambda row: is_held_out(row["world"], row["robot"]),
}
"""What of the episodes belongs to a group, by its name."""


def paired_times(rows: Sequence[Row], policy: str, reference: str) -> tuple[list[np.ndarray], ...]:
    """Return the times of a policy and of a reference [s], and where they reached the target, by world and SLAM.

    Raises:
        ValueError: if they have no start in common.
    """
    found: dict[str, dict[tuple[str, ...], tuple[float, bool]]] = {policy: {}, reference: {}}
    for row in rows:
        if row["policy"] in found:
            time = float(row["time_to_95"])
            reached = math.isfinite(time)
            value = max(time if reached else float(row["time_limit"]), LEAST_TIME)
            found[row["policy"]][_start(row)] = value, reached
    common = sorted(found[policy].keys() & found[reference].keys())
    if not common:
        raise ValueError(f"{policy!r} and {reference!r} have no start in common")
    strata: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for start in common:
        strata.setdefault(start[:-1], []).append(start)

    def column(name: str, part: int) -> list[np.ndarray]:
        return [np.array([found[name][start][part] for start in starts]) for starts in strata.values()]

    return column(policy, 0), column(reference, 0), column(policy, 1), column(reference, 1)


def _start(row: Row) -> tuple[str, ...]:
    return tuple(row[key] for key in ("world", "robot", "physics", "slam", "seed"))


def _starts(rows: Sequence[Row], policy: str) -> set[tuple[str, ...]]:
    return {_start(row) for row in rows if row["policy"] == policy}


def describe(rows: Sequence[Row], policy: str, reference: str) -> list[str]:
    """Return the cells of a policy's row in the table."""
    own, other, reached, other_reached = paired_times(rows, policy, reference)
    ratio, better = paired_ratio(own, other), probability_of_improvement(own, other, higher_is_better=False)
    cells = [f"{e.iqm:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in (ratio, better)]
    counts = [str(int(np.concatenate(flags).sum())) for flags in (reached, other_reached)]
    closed = ""
    bound = bound_of(row["policy"] for row in rows) or ""
    starts = [_starts(rows, name) for name in (policy, reference, bound)]
    if not is_bound(policy) and (common := set.intersection(*starts)):
        among = [row for row in rows if _start(row) in common]
        gains = [
            [np.log(y / x) for x, y in zip(*paired_times(among, name, reference)[:2], strict=True)]
            for name in (policy, bound)
        ]
        share = gap_closed(*gains)
        closed = f"{100 * share.iqm:.0f} % [{100 * share.low:.0f}, {100 * share.high:.0f}]"
    return [policy, str(ratio.n), *cells, *counts, closed]


def main(
    folder: Annotated[Path, tyro.conf.Positional],
    reference: str = "gain_over_cost",
    groups: bool = False,
    by: tuple[Literal["world", "robot", "physics", "slam"], ...] = (),
) -> None:
    """Print the table.

    Args:
        folder: of an evaluation.
        reference: name of the policy that the others are compared with.
        groups: whether to show groups of episodes, too, by what training has seen of them.
        by: columns of the evaluation, for each value of which there is a group.
    """
    with open(folder / "episodes.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = ("episodes", "policy", "pairs", f"time / {reference}'s", "faster", "reached", f"{reference} reached")
    table = Table(*columns, "gap closed")
    policies = [name for name in dict.fromkeys(row["policy"] for row in rows) if name != reference]
    tables = {name: [row for row in rows if holds(row)] for name, holds in GROUPS.items() if groups or name == "all"}
    for column in by:
        for value in sorted({row[column] for row in rows}):
            tables[value] = [row for row in rows if row[column] == value]
    for group, members in tables.items():
        if members:
            table.add_section()
            for policy in policies:
                if _starts(members, policy) & _starts(members, reference):
                    table.add_row(group, *describe(members, policy, reference))
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
