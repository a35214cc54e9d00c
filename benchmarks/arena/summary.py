"""From rows of episodes to estimates per policy and case, and to the ranking of the policies."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.arena.measures import Measures
from benchmarks.arena.pairs import (
    bound_of,
    from_shared_starts,
    paired_values,
    policies_of,
    pool,
    reference_of,
    split,
)
from benchmarks.arena.policies import is_bound
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, gap_closed
from envs.measures import Measure

Summary = dict[str, dict[str, dict[str, Estimate]]]
"""Estimates by policy, case and measure. A case is called by its world, and by what else distinguishes it."""
JSON = ("iqm", "low", "high", "n", "never")
"""Fields of an estimate that `summary.json` holds."""


def summarise(rows: Sequence[Row], measures: Measures) -> Summary:
    """Estimate every measure for every policy in every case."""
    summary: Summary = {}
    for label, here in split(rows).items():
        for policy in policies_of(here):
            summary.setdefault(policy, {})[label] = {
                measure.name: pool(here, policy, measure) for measure in measures.all
            }
    return summary


def to_json(summary: Summary) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return the summary as `summary.json` holds it."""
    return {
        policy: {
            label: {measure: dict(zip(JSON, value, strict=False)) for measure, value in estimates.items()}
            for label, estimates in cases.items()
        }
        for policy, cases in summary.items()
    }


def best_of(estimates: Mapping[str, Estimate], measure: Measure) -> set[str]:
    """Return the policies whose estimate, as printed, is the best; none if all are alike or none is better.

    Bounds do not compete.
    """
    # A lower bound is more than the same number reached.
    shown = {
        policy: (float(measure.text(value.iqm)), value.is_bound[0])
        for policy, value in estimates.items()
        if not is_bound(policy)
    }
    if measure.higher_is_better is None or not shown:
        return set()
    best = max(shown.values()) if measure.higher_is_better else min(shown.values())
    winners = {policy for policy, value in shown.items() if value == best}
    return winners if len(winners) < len(shown) else set()


def standing(rows: Sequence[Row], measure: Measure) -> dict[str, Estimate]:
    """Return a measure of the policies, best first, and bounds, which do not compete, at the end.

    A lower bound comes after the same number reached; policies without that measure are left out.
    """
    found = {policy: pool(rows, policy, measure) for policy in policies_of(row for row in rows if measure.name in row)}
    sign = -1.0 if measure.higher_is_better else 1.0
    return dict(sorted(found.items(), key=lambda item: (is_bound(item[0]), sign * item[1].iqm, item[1].is_bound[0])))


def competitors(rows: Sequence[Row], measure: Measure) -> dict[str, Estimate]:
    """Return a measure of the policies that compete, best first."""
    return {policy: value for policy, value in standing(rows, measure).items() if not is_bound(policy)}


def gaps(rows: Sequence[Row], policy: str, measures: Measures) -> dict[str, Estimate]:
    """Return which share of the gap from the reference to the bound a policy closes, by the names of `Measures.gaps`.

    Only starts count from which all three have an episode. Empty where one of them takes no part, or is the policy.

    Args:
        rows: related episodes (`benchmarks.arena.pairs.relate`).
        policy: name of the policy.
        measures: of the task.
    """
    policies = policies_of(rows)
    reference, bound = reference_of(policies), bound_of(policies)
    if bound is None or policy == reference or is_bound(policy):
        return {}
    shared = from_shared_starts(rows, (policy, reference, bound))
    found = {}
    for measure in measures.gaps if shared else ():
        sign = 1.0 if measure.higher_is_better else -1.0
        pairs = (zip(*paired_values(shared, name, reference, measure), strict=True) for name in (policy, bound))
        gains, bounds = ([sign * (ours - theirs) for ours, theirs in one] for one in pairs)
        found[measure.name] = gap_closed(gains, bounds)
    return found


def typical_and_worst(rows: Sequence[Row], policy: str, measure: Measure) -> tuple[Row, Row]:
    """Return a policy's median episode and its worst one, by a measure."""
    mine = sorted((row for row in rows if row["policy"] == policy), key=lambda row: row[measure.name])
    return mine[len(mine) // 2], mine[0 if measure.higher_is_better else -1]
