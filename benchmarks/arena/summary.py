"""From rows of episodes to estimates per policy and world, and to comparisons between policies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from benchmarks.arena.measures import BY_NAME, MEASURES, Measure
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import (
    Estimate,
    estimate,
    paired_difference,
    probability_of_improvement,
    success_rate,
)

Summary = dict[str, dict[str, dict[str, Estimate]]]
"""Estimates by policy, world and measure."""

COMPARED = ("area_under_curve", "time_to_95", "distance_to_95")
"""Measures in which policies are compared pair by pair."""


def summarise(rows: Sequence[Row]) -> Summary:
    """Estimate every measure for every policy in every world."""
    summary: Summary = {}
    for policy, world in dict.fromkeys((row["policy"], row["world"]) for row in rows):
        summary.setdefault(policy, {})[world] = {
            measure.name: pool([values_of(rows, policy, world, measure)], measure) for measure in MEASURES
        }
    return summary


def to_json(summary: Summary) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return the summary as `summary.json` holds it."""
    return {
        policy: {
            world: {measure: value._asdict() for measure, value in estimates.items()}
            for world, estimates in worlds.items()
        }
        for policy, worlds in summary.items()
    }


def pool(strata: Sequence[np.ndarray], measure: Measure) -> Estimate:
    """Estimate a measure over one world or several: an interquartile mean, or for `success_rate` a share."""
    return success_rate(strata) if measure.name == "success_rate" else estimate(strata)


def values_of(rows: Sequence[Row], policy: str, world: str, measure: Measure) -> np.ndarray:
    """Return a measure of a policy's episodes in a world in the order of their seeds: shape (episodes,), float64."""
    mine = [row for row in rows if row["policy"] == policy and row["world"] == world]
    return np.array([row[measure.column] for row in sorted(mine, key=lambda row: row["seed"])], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A policy against the reference, on the same worlds and seeds."""

    policy: str
    """Who is compared."""
    reference: str
    """With whom."""
    measure: Measure
    """In what."""
    difference: Estimate
    """Interquartile mean of policy minus reference."""
    improvement: Estimate
    """Probability that the policy does better than the reference."""


def compare(rows: Sequence[Row], worlds: Sequence[str], measures: Sequence[str] = COMPARED) -> list[Comparison]:
    """Compare every policy with the reference: `frontier` if it takes part, else the first policy.

    Args:
        rows: all episodes.
        worlds: the strata. Where they are several, the measures should be comparable between worlds.
        measures: names.
    """
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    reference = "frontier" if "frontier" in policies else policies[0]
    comparisons = []
    for policy in policies:
        for measure in (BY_NAME[name] for name in measures):
            a, b = ([values_of(rows, name, world, measure) for world in worlds] for name in (policy, reference))
            if policy != reference and measure.higher_is_better is not None:
                better = probability_of_improvement(a, b, measure.higher_is_better)
                comparisons.append(Comparison(policy, reference, measure, paired_difference(a, b), better))
    return comparisons


def best_of(estimates: dict[str, Estimate], measure: Measure) -> set[str]:
    """Return the policies whose estimate, as printed, is the best; none if all are alike or none is better."""
    if measure.higher_is_better is None:
        return set()
    shown = {policy: float(measure.text(value.iqm)) for policy, value in estimates.items()}
    best = max(shown.values()) if measure.higher_is_better else min(shown.values())
    winners = {policy for policy, value in shown.items() if value == best}
    return winners if len(winners) < len(shown) else set()


def terminal_table(summary: Summary, world: str) -> Table:
    """Lay out a world's estimates for the terminal: a row per measure, a column per policy."""
    policies = [policy for policy in summary if world in summary[policy]]
    num_episodes = summary[policies[0]][world]["explored_fraction"].n
    table = Table(
        title=f"{world}, {num_episodes} episodes",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("", no_wrap=True)
    for policy in policies:
        table.add_column(policy, justify="right", overflow="fold")
    for measure in MEASURES:
        estimates = {policy: summary[policy][world][measure.name] for policy in policies}
        best = best_of(estimates, measure)
        cells = [
            f"{'[bold]' if policy in best else ''}{measure.text(value.iqm)}{'[/bold]' if policy in best else ''} "
            f"[dim]\\[{measure.text(value.low)},{measure.text(value.high)}][/dim]"
            for policy, value in estimates.items()
        ]
        table.add_row(f"{measure.label} [dim]{measure.unit}[/dim]", *cells)
    return table
