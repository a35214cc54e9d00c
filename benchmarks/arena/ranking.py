"""The ranking of explorers over all worlds: what the leaderboard shows, as numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.arena.measures import BY_NAME, Measure
from benchmarks.arena.pairs import BOUND, by_start, case_of, paired_values, policies_of, pool, reference_of, values_of
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, gap_closed

PRIMARY = BY_NAME["area_under_curve"]
"""What the explorers are ranked by: it has no threshold, and every episode has one."""
SHOWN = tuple(
    BY_NAME[name]
    for name in (
        "area_under_curve",
        "explored_fraction",
        "relative_time",
        "relative_distance",
        "reached_95",
        "success_rate",
        "collisions",
        "decision_ms",
    )
)
"""Columns of the leaderboard."""
GAPS = tuple(BY_NAME[name] for name in ("area_under_curve", "relative_time", "relative_distance"))
"""Measures in which the gap between the reference and the bound is closed, more or less."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An explorer on the leaderboard."""

    policy: str
    rank: int | None
    """From 1; None for the bound, which does not compete."""
    estimates: dict[str, Estimate]
    """By the names of `SHOWN`."""


def rank(rows: Sequence[Row]) -> list[Entry]:
    """Return the explorers, best first, and the bound at the end.

    Args:
        rows: episodes with `RELATIVE` and `REACHED` (`benchmarks.arena.pairs.relate`).
    """
    estimates = {
        policy: {measure.name: pool(rows, policy, measure) for measure in SHOWN if values_of(rows, policy, measure)}
        for policy in policies_of(rows)
    }
    competitors = sorted(
        (policy for policy in estimates if policy != BOUND), key=lambda policy: -estimates[policy][PRIMARY.name].iqm
    )
    entries = [Entry(policy, k, estimates[policy]) for k, policy in enumerate(competitors, start=1)]
    return [*entries, *(Entry(policy, None, estimates[policy]) for policy in estimates if policy == BOUND)]


def gaps(rows: Sequence[Row], policy: str) -> dict[str, Estimate]:
    """Return which share of the gap from the reference to the bound a policy closes, by the names of `GAPS`.

    Only starts count from which all three have an episode. Empty where one of them takes no part, or is the policy.

    Args:
        rows: episodes with `RELATIVE` (`benchmarks.arena.pairs.relate`).
        policy: name of the policy.
    """
    policies = policies_of(rows)
    reference = reference_of(policies)
    if BOUND not in policies or policy in (reference, BOUND):
        return {}
    starts = set.intersection(*(set(by_start(rows, name)) for name in (policy, reference, BOUND)))
    if not starts:
        return {}
    shared = [row for row in rows if (case_of(row), row["seed"]) in starts]
    return {
        measure.name: gap_closed(_gains(shared, policy, reference, measure), _gains(shared, BOUND, reference, measure))
        for measure in GAPS
    }


def _gains(rows: Sequence[Row], policy: str, reference: str, measure: Measure) -> list[np.ndarray]:
    """Return by how much a policy does better than the reference: per case, shape (episodes,)."""
    sign = 1.0 if measure.higher_is_better else -1.0
    pairs = zip(*paired_values(rows, policy, reference, measure), strict=True)
    return [sign * (ours - theirs) for ours, theirs in pairs]


def typical_and_worst(rows: Sequence[Row], policy: str) -> tuple[Row, Row]:
    """Return a policy's median episode and its worst one, by `PRIMARY`."""
    mine = sorted((row for row in rows if row["policy"] == policy), key=lambda row: row[PRIMARY.column])
    return mine[len(mine) // 2], mine[0]
