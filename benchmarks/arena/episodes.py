"""Statistics of evaluated episodes: estimates, paired comparisons and rankings of policies."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from lidarnaut.agents.frontiers.tasks import is_held_out
from lidarnaut.agents.policy_names import is_bound
from lidarnaut.agents.statistics import (
    Estimate,
    estimate,
    interquartile_mean,
    paired_difference,
    paired_ratio,
    success_rate,
)
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.measures import MIN_STARTS, Measures
from lidarnaut.envs.measures import TIME_TO_SUCCESS, Measure

REFERENCES = ("dock", "boustrophedon", "nearest", "frontier", "pursuit", "rrt_team", "route_follower")
"""Names of policies that serve as the reference of comparisons, in order of preference; otherwise, the first policy."""

MIN_RATIO_VALUE = 1.0
"""Lower limit of times [s] and distances [m] in ratios between policies; smaller values are raised to it."""

Case = tuple[str, ...]
"""Conditions of an episode: world, robot, physics, SLAM or localizer, and people."""
Summary = dict[str, dict[str, dict[str, Estimate]]]
"""Estimates of performance measures by policy name, conditions and measure name."""


def case_of(row: Row) -> Case:
    return row["world"], row["robot"], row["physics"], row["slam"], f"{row.get('people', 0)} people"


def start_of(row: Row) -> tuple[Case, int]:
    return case_of(row), row["seed"]


def raw_value(row: Row, measure: Measure) -> float:
    """Return the value of a measure in an episode; infinite if a threshold was not reached."""
    if measure is TIME_TO_SUCCESS and measure.name not in row:
        return row["duration"] if row["success"] else math.inf
    return float(row[measure.name])


def value_of(row: Row, measure: Measure) -> float:
    """Return the value of a measure in an episode, capped at the time or distance limit if any."""
    return min(raw_value(row, measure), row[measure.limit] if measure.limit else math.inf)


class Episodes:
    """Table of evaluated episodes of one task, with statistics by policy."""

    def __init__(self, rows: Iterable[Row], measures: Measures, reference: str = "") -> None:
        """Create a table of `rows`; `reference` is the name of the reference policy, if not the usual one."""
        self.rows, self.measures, self._reference = list(rows), measures, reference

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def like(self, rows: Iterable[Row]) -> "Episodes":
        return Episodes(rows, self.measures, self._reference)

    def where(self, keep: Callable[[Row], Any]) -> "Episodes":
        return self.like(filter(keep, self))

    def of(self, policy: str) -> list[Row]:
        return [row for row in self if row["policy"] == policy]

    @cached_property
    def policies(self) -> list[str]:
        return list(dict.fromkeys(row["policy"] for row in self))

    @property
    def reference(self) -> str:
        """Name of the policy that the other policies are compared with."""
        return next((name for name in (self._reference, *REFERENCES) if name in self.policies), self.policies[0])

    @property
    def bound(self) -> str | None:
        """Name of the first policy with access to ground truth (upper bound of performance), if any."""
        return next(filter(is_bound, self.policies), None)

    @cached_property
    def labels(self) -> dict[Case, str]:
        cases = list(dict.fromkeys(map(case_of, self)))
        labels = {}
        for case in cases:
            alike = zip(*(other for other in cases if other[0] == case[0]))
            varied = [value for value, values in zip(case, alike) if len(set(values)) > 1]
            labels[case] = ", ".join((case[0], *varied))
        return labels

    def place(self, row: Row) -> str:
        return f"{self.labels[case_of(row)]}, seed {row['seed']}"

    def by_case(self) -> dict[str, "Episodes"]:
        parts: dict[str, list[Row]] = {label: [] for label in self.labels.values()}
        for row in self:
            parts[self.labels[case_of(row)]].append(row)
        return {label: self.like(rows) for label, rows in parts.items()}

    def by_start(self, policy: str) -> dict[tuple[Case, int], Row]:
        return {start_of(row): row for row in self.of(policy)}

    def unseen(self) -> "Episodes":
        """Return only the episodes in worlds or with robots not used in training.

        Empty without learned policies, or if these are all episodes.
        """
        found = self.where(lambda row: is_held_out(row["world"], row["robot"]))
        return found if len(found) < len(self) and any(row["model"] for row in self) else self.like(())

    def shared(self, policies: Iterable[str] = ()) -> "Episodes":
        """Return the episodes with conditions and seeds that all given policies have completed.

        Default: all policies without access to ground truth.
        """
        names = list(policies) or [name for name in self.policies if not is_bound(name)] or self.policies
        starts = set.intersection(*(set(self.by_start(name)) for name in names)) if names else set()
        return self.where(lambda row: start_of(row) in starts)

    def values(self, policy: str, measure: Measure) -> list[np.ndarray]:
        """Return the values of a measure for a policy: one array per combination of conditions, ordered by seed."""
        return _strata(self.of(policy), measure)

    def pairs(self, a: str, b: str, measure: Measure) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the values of a measure for policies `a` and `b` in episodes with equal conditions and seed.

        Both lists have one array per combination of conditions, in equal order.
        """
        theirs = self.by_start(b)
        shared = [row for row in self.of(a) if start_of(row) in theirs]
        return _strata(shared, measure), _strata([theirs[start_of(row)] for row in shared], measure)

    def gap(self, a: str, b: str, measure: Measure) -> Estimate:
        """Return how policies `a` and `b` differ from equal starts, with its 95 % interval.

        Times and distances, also those of `Measures.ratios`: geometric mean of the ratios a / b. Binary measures: mean
        of the differences a - b; other measures: their interquartile mean.

        Raises:
            ValueError: if the policies have no start in common.
        """
        first, second = self.pairs(a, b, self.measures.times.get(measure.name, measure))
        if measure.limit:
            return paired_ratio(*([values.clip(MIN_RATIO_VALUE) for values in strata] for strata in (first, second)))
        return paired_difference(first, second, np.mean if measure.is_share else interquartile_mean)

    def estimate(self, policy: str, measure: Measure) -> Estimate:
        """Return the interquartile mean of a measure for a policy, the proportion for a binary measure, or a ratio.

        Ratios are those of `gap` to the reference policy; a threshold that was not reached counts as the limit.

        Raises:
            ValueError: if no episode has this measure.
        """
        mine = self.of(policy)
        if measure.is_share:
            return success_rate(_strata(mine, measure))
        if time := self.measures.times.get(measure.name):
            found, starts = self.gap(policy, self.reference, measure), self.by_start(self.reference)
            missed = sum(math.isinf(raw_value(row, time)) for row in mine if start_of(row) in starts)
            return found._replace(never=missed, is_bound=(missed > 0, False, False))
        reached = _strata(mine, measure, lambda row, _: np.isfinite(raw_value(row, measure)))
        return estimate(_strata(mine, measure), reached)

    def summary(self) -> Summary:
        summary: Summary = {policy: {} for policy in self.policies}
        for label, here in self.by_case().items():
            for policy in here.policies:
                summary[policy][label] = {one.name: here.estimate(policy, one) for one in self.measures.all}
        return summary

    def standing(self, measure: Measure) -> dict[str, Estimate]:
        """Return the estimates of a measure by policy, best first; policies with access to ground truth come last."""
        names = self.policies
        if measure.name in self.measures.times:
            names = [name for name in names if self.by_start(name).keys() & self.by_start(self.reference).keys()]
        found = {name: self.estimate(name, measure) for name in names}
        sign = -1.0 if measure.higher_is_better else 1.0
        return dict(sorted(found.items(), key=lambda one: (is_bound(one[0]), sign * one[1].iqm, one[1].is_bound[0])))

    def competitors(self, measure: Measure) -> dict[str, Estimate]:
        return {policy: value for policy, value in self.standing(measure).items() if not is_bound(policy)}

    def typical_and_worst(self, policy: str) -> tuple[Row, Row]:
        headline = self.measures.headline
        mine = sorted(self.of(policy), key=lambda row: row[headline.name])
        return mine[len(mine) // 2], mine[0 if headline.higher_is_better else -1]


def _strata(rows: Sequence[Row], measure: Measure, value: Callable[[Row, Measure], Any] = value_of) -> list[np.ndarray]:
    strata: dict[Case, list[Any]] = {}
    for row in sorted(rows, key=start_of):
        strata.setdefault(case_of(row), []).append(value(row, measure))
    return [np.array(stratum) for stratum in strata.values()]


def best_of(estimates: Mapping[str, Estimate], measure: Measure) -> str:
    """Return the policy whose interval is better than those of all others; empty if there is none.

    Policies with access to ground truth are ignored. It takes `MIN_STARTS` starts.
    """
    sign = 1.0 if measure.higher_is_better else -1.0
    ends = {name: sorted((sign * one.low, sign * one.high)) for name, one in estimates.items() if not is_bound(name)}
    if measure.higher_is_better is None or len(ends) < 2 or min(estimates[name].n for name in ends) < MIN_STARTS:
        return ""
    best, *others = sorted(ends, key=lambda name: -ends[name][0])
    return best if ends[best][0] > max(ends[other][1] for other in others) else ""
