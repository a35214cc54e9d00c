"""Episodes that share a start: what makes policies comparable with each other, and worlds with each other."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from agents.frontiers.tasks import is_held_out
from benchmarks.arena.measures import Measures, share_of
from benchmarks.arena.policies import is_bound
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, estimate, success_rate
from envs.measures import Measure

REFERENCES = ("nearest", "frontier", "pursuit", "rrt_team", "route_follower")
"""Policies that the others are compared with: the first of these that takes part, or else the first policy."""
PAIRED_AXES = ("physics", "slam")
"""Columns along which starts stay the same. Robots differ in which cells they can traverse."""

Case = tuple[str, str, str, str]
"""World, robot, physics and SLAM (or localizer): a stratum of the statistics."""
Start = tuple[Case, int]
"""Case and seed."""


def case_of(row: Row) -> Case:
    """Return where, and under which conditions."""
    return row["world"], row["robot"], row["physics"], row["slam"]


def start_of(row: Row) -> Start:
    """Return what an episode shares with those of other policies."""
    return case_of(row), row["seed"]


def label_cases(rows: Iterable[Row]) -> dict[Case, str]:
    """Name every case by its world, and by those of its conditions that are not the same in all of that world."""
    cases = list(dict.fromkeys(map(case_of, rows)))
    labels = {}
    for case in cases:
        alike = [other for other in cases if other[0] == case[0]]
        varied = [case[k] for k in (1, 2, 3) if len({other[k] for other in alike}) > 1]
        labels[case] = ", ".join((case[0], *varied))
    return labels


def split(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows by the label of their case."""
    labels = label_cases(rows)
    parts: dict[str, list[Row]] = {}
    for row in rows:
        parts.setdefault(labels[case_of(row)], []).append(row)
    return parts


def policies_of(rows: Iterable[Row]) -> list[str]:
    """Return the policies in the order in which they come."""
    return list(dict.fromkeys(row["policy"] for row in rows))


def held_out(rows: Sequence[Row]) -> list[Row]:
    """Return the episodes in worlds or with robots that are held out; none if all are, or nothing was learned."""
    found = [row for row in rows if is_held_out(row["world"], row["robot"])]
    return found if len(found) < len(rows) and any(row["model"] for row in rows) else []


def reference_of(policies: Sequence[str]) -> str:
    """Return the policy that the others are compared with."""
    return next((name for name in REFERENCES if name in policies), policies[0])


def bound_of(policies: Iterable[str]) -> str | None:
    """Return the policy that bounds what can be reached: the first that was given ground truth; None without one."""
    return next(filter(is_bound, policies), None)


def by_start(rows: Iterable[Row], policy: str) -> dict[Start, Row]:
    """Return a policy's episodes by their starts."""
    return {start_of(row): row for row in rows if row["policy"] == policy}


def from_shared_starts(rows: Sequence[Row], policies: Iterable[str]) -> list[Row]:
    """Return the episodes, of whichever policy, from starts from which all of some policies have one."""
    starts = set.intersection(*(set(by_start(rows, policy)) for policy in policies))
    return [row for row in rows if start_of(row) in starts]


def common_starts(rows: Sequence[Row]) -> list[Row]:
    """Return the episodes from starts from which every competitor has one: no policy profits from a world left out."""
    policies = policies_of(rows)
    return from_shared_starts(rows, [name for name in policies if not is_bound(name)] or policies) if policies else []


def relate(rows: Sequence[Row], measures: Measures, reference: str | None = None) -> list[Row]:
    """Return the rows with `Measures.reached` added, and `Measures.relative` where the reference has the same start.

    Where the reference never reached the mark, its limit is what others are divided by. None takes the usual reference.
    """
    if not rows:
        return []
    references = by_start(rows, reference or reference_of(policies_of(rows)))
    related = []
    for row in rows:
        row = row | {reached.name: int(np.isfinite(row[measures.marks[0].name])) for reached in measures.reached}
        same_start = references.get(start_of(row))
        for mark in measures.marks:
            if same_start is None:
                break
            unit, share = value_of(same_start, mark), share_of(mark)
            for name, value in ((share.name, row[mark.name]), (share.limit, row[mark.limit])):
                # Zero where the first scan shows 95 %: it shows that to everyone.
                row[name] = value / unit if unit > 0.0 else 1.0
        related.append(row)
    return related


def value_of(row: Row, measure: Measure) -> float:
    """Return what an episode counts as: its limit where it never reached the mark."""
    return float(min(row[measure.name], row[measure.limit]) if measure.limit else row[measure.name])


def values_of(rows: Iterable[Row], policy: str, measure: Measure) -> list[np.ndarray]:
    """Return what a policy's episodes count as (`value_of`): per case an array in the order of seeds, float64."""
    return _by_case(_with(rows, policy, measure), partial(value_of, measure=measure))


def pool(rows: Iterable[Row], policy: str, measure: Measure) -> Estimate:
    """Estimate a measure of a policy's episodes over all cases: an interquartile mean, or of what is 0 or 1 the share.

    Raises:
        ValueError: if it has no episode with that measure.
    """
    mine = _with(rows, policy, measure)
    strata = _by_case(mine, partial(value_of, measure=measure))
    if measure.is_share:
        return success_rate(strata)
    return estimate(strata, _by_case(mine, lambda row: bool(np.isfinite(row[measure.name]))))


def paired_values(rows: Sequence[Row], a: str, b: str, measure: Measure) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return a measure of two policies from the starts that they share: per case an array each, in the same order."""
    theirs, value = by_start(rows, b), partial(value_of, measure=measure)
    shared = [row for row in _with(rows, a, measure) if start_of(row) in theirs]
    return _by_case(shared, value), _by_case([theirs[start_of(row)] for row in shared], value)


def _with(rows: Iterable[Row], policy: str, measure: Measure) -> list[Row]:
    return [row for row in rows if row["policy"] == policy and measure.name in row]


def _by_case(rows: Iterable[Row], value: Callable[[Row], float]) -> list[np.ndarray]:
    strata: dict[Case, list[float]] = {}
    for row in sorted(rows, key=start_of):
        strata.setdefault(case_of(row), []).append(value(row))
    return [np.array(stratum) for stratum in strata.values()]
