"""Episodes that share a start: what makes explorers comparable with each other, and worlds with each other."""

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.arena.measures import BY_NAME, Measure
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, estimate, success_rate

BOUND = "oracle"
"""Explorer that uses ground truth. It bounds what can be reached, and does not compete."""
REFERENCES = ("nearest", "frontier")
"""Policies that the others are compared with: the first of these that takes part, or else the first policy."""
PAIRED_AXES = ("physics", "slam")
"""Columns along which starts stay the same. Robots differ in which cells they can traverse."""

Case = tuple[str, str, str, str]
"""World, robot, physics and SLAM: a stratum of the statistics."""


def case_of(row: Row) -> Case:
    """Return where, and under which conditions."""
    return row["world"], row["robot"], row["physics"], row["slam"]


def label_cases(rows: Iterable[Row]) -> dict[Case, str]:
    """Name every case by its world, and by those of its conditions that are not the same in all of that world."""
    cases = list(dict.fromkeys(map(case_of, rows)))
    labels = {}
    for case in cases:
        alike = [other for other in cases if other[0] == case[0]]
        varied = [case[k] for k in (1, 2, 3) if len({other[k] for other in alike}) > 1]
        labels[case] = ", ".join((case[0], *varied))
    return labels


def policies_of(rows: Iterable[Row]) -> list[str]:
    """Return the policies in the order in which they come."""
    return list(dict.fromkeys(row["policy"] for row in rows))


def reference_of(policies: Sequence[str]) -> str:
    """Return the policy that the others are compared with."""
    return next((name for name in REFERENCES if name in policies), policies[0])


def by_start(rows: Iterable[Row], policy: str) -> dict[tuple[Case, int], Row]:
    """Return a policy's episodes by case and seed."""
    return {(case_of(row), row["seed"]): row for row in rows if row["policy"] == policy}


def common_starts(rows: Sequence[Row]) -> list[Row]:
    """Return the episodes from starts from which every competitor has one: no policy profits from a world left out."""
    competitors = [name for name in policies_of(rows) if name != BOUND] or policies_of(rows)
    starts = set.intersection(*(set(by_start(rows, name)) for name in competitors)) if competitors else set()
    return [row for row in rows if (case_of(row), row["seed"]) in starts]


def relate(rows: Sequence[Row], reference: str | None = None) -> list[Row]:
    """Return the rows with `REACHED` added, and `RELATIVE` where the reference has an episode from the same start.

    Where the reference never reached the mark, its limit is what others are divided by.

    Args:
        rows: episodes.
        reference: a policy; None takes the usual one.
    """
    if not rows:
        return []
    references = by_start(rows, reference or reference_of(policies_of(rows)))
    related = []
    for row in rows:
        same_start = references.get((case_of(row), row["seed"]))
        related.append(row | {"reached_95": int(row["explored_fraction"] >= 0.95)})
        if same_start is not None:
            for relative, column in (("relative_time", "time_to_95"), ("relative_distance", "distance_to_95")):
                measure = BY_NAME[column]
                # Zero where the first scan shows 95 %: it shows that to everyone.
                unit = value_of(same_start, measure)
                shares = [value / unit if unit > 0.0 else 1.0 for value in (row[column], row[measure.limit])]
                related[-1] |= dict(zip((relative, BY_NAME[relative].limit), shares, strict=True))
    return related


def value_of(row: Row, measure: Measure) -> float:
    """Return what an episode counts as: its limit where it never reached the mark."""
    return min(row[measure.column], row[measure.limit]) if measure.limit else row[measure.column]


def values_of(rows: Iterable[Row], policy: str, measure: Measure) -> list[np.ndarray]:
    """Return what a policy's episodes count as (`value_of`): per case an array in the order of seeds, float64."""
    mine = by_start(rows, policy).items()
    return _by_case({start: value_of(row, measure) for start, row in mine if measure.column in row})


def pool(rows: Iterable[Row], policy: str, measure: Measure) -> Estimate:
    """Estimate a measure of a policy's episodes over all cases: an interquartile mean, or of what is 0 or 1 the share.

    Raises:
        ValueError: if it has no episode with that measure.
    """
    strata = values_of(rows, policy, measure)
    if measure.is_share:
        return success_rate(strata)
    mine = by_start(rows, policy).items()
    reached = _by_case({s: float(np.isfinite(row[measure.column])) for s, row in mine if measure.column in row})
    return estimate(strata, [stratum > 0.0 for stratum in reached])


def paired_values(rows: Sequence[Row], a: str, b: str, measure: Measure) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return a measure of two policies from the starts that they share: per case an array each, in the same order."""
    ours, theirs = by_start(rows, a), by_start(rows, b)
    shared = [start for start in ours if start in theirs and measure.column in ours[start]]
    first, second = ({start: value_of(side[start], measure) for start in shared} for side in (ours, theirs))
    return _by_case(first), _by_case(second)


def _by_case(values: dict[tuple[Case, int], float]) -> list[np.ndarray]:
    strata: dict[Case, list[float]] = {}
    for case, seed in sorted(values):
        strata.setdefault(case, []).append(values[case, seed])
    return [np.array(stratum, dtype=np.float64) for stratum in strata.values()]
