"""From rows of episodes to estimates per policy and case, and to comparisons between policies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.arena.measures import BY_NAME, MEASURES, Measure
from benchmarks.arena.pairs import BOUND, case_of, label_cases, paired_values, policies_of, pool, reference_of
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, paired_difference, probability_of_improvement

Summary = dict[str, dict[str, dict[str, Estimate]]]
"""Estimates by policy, case and measure. A case is called by its world, and by what else distinguishes it."""

JSON = ("iqm", "low", "high", "n", "never")
"""Fields of an estimate that `summary.json` holds."""
COMPARED = tuple(BY_NAME[name] for name in ("area_under_curve", "time_to_95", "distance_to_95"))
"""Measures in which policies are compared pair by pair in one world."""


def summarise(rows: Sequence[Row]) -> Summary:
    """Estimate every measure for every policy in every case."""
    summary: Summary = {}
    for label, here in split(rows).items():
        for policy in policies_of(here):
            summary.setdefault(policy, {})[label] = {measure.name: pool(here, policy, measure) for measure in MEASURES}
    return summary


def split(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows by the label of their case."""
    labels = label_cases(rows)
    parts: dict[str, list[Row]] = {}
    for row in rows:
        parts.setdefault(labels[case_of(row)], []).append(row)
    return parts


def to_json(summary: Summary) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return the summary as `summary.json` holds it."""
    return {
        policy: {
            label: {measure: dict(zip(JSON, value, strict=False)) for measure, value in estimates.items()}
            for label, estimates in cases.items()
        }
        for policy, cases in summary.items()
    }


@dataclass(frozen=True, slots=True)
class Comparison:
    """A policy against the reference, on the same worlds and seeds."""

    policy: str
    reference: str
    measure: Measure
    difference: Estimate
    """Interquartile mean of policy minus reference."""
    improvement: Estimate
    """Probability that the policy does better than the reference."""


def compare(rows: Sequence[Row], measures: Sequence[Measure] = COMPARED) -> list[Comparison]:
    """Compare every policy with the reference (`benchmarks.arena.pairs`) on the starts that they share.

    Args:
        rows: all episodes. Where they are of several cases, the measures should be comparable between them.
        measures: in which.
    """
    policies = policies_of(rows)
    reference = reference_of(policies)
    comparisons = []
    for policy in policies:
        for measure in measures:
            a, b = paired_values(rows, policy, reference, measure)
            if policy != reference and a and measure.higher_is_better is not None:
                better = probability_of_improvement(a, b, measure.higher_is_better)
                comparisons.append(Comparison(policy, reference, measure, paired_difference(a, b), better))
    return comparisons


def best_of(estimates: dict[str, Estimate], measure: Measure) -> set[str]:
    """Return the policies whose estimate, as printed, is the best; none if all are alike or none is better.

    The bound does not compete.
    """
    # A lower bound is more than the same number reached.
    shown = {
        policy: (float(measure.text(value.iqm)), value.is_bound[0])
        for policy, value in estimates.items()
        if policy != BOUND
    }
    if measure.higher_is_better is None or not shown:
        return set()
    best = max(shown.values()) if measure.higher_is_better else min(shown.values())
    winners = {policy for policy, value in shown.items() if value == best}
    return winners if len(winners) < len(shown) else set()
