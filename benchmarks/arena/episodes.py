"""Statistics of evaluated episodes: estimates, paired comparisons and rankings of policies."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from lidarnaut.agents.frontiers.tasks import is_held_out
from lidarnaut.agents.policy_names import is_bound
from lidarnaut.agents.statistics import Estimate, estimate, success_rate
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.measures import Measures, share_of
from lidarnaut.envs.measures import Measure

REFERENCES = ("dock", "boustrophedon", "nearest", "frontier", "pursuit", "rrt_team", "route_follower")
"""Names of policies that serve as the reference of comparisons, in order of preference; otherwise, the first policy."""

Case = tuple[str, ...]
"""Conditions of an episode: world, robot, physics, SLAM or localizer, and people."""
Summary = dict[str, dict[str, dict[str, Estimate]]]
"""Estimates of performance measures by policy name, conditions and measure name."""


def case_of(row: Row) -> Case:
    return row["world"], row["robot"], row["physics"], row["slam"], f"{row.get('people', 0)} people"


def start_of(row: Row) -> tuple[Case, int]:
    return case_of(row), row["seed"]


def value_of(row: Row, measure: Measure) -> float:
    """Return the value of a measure in an episode, capped at the time or distance limit if any."""
    return float(min(row[measure.name], row[measure.limit]) if measure.limit else row[measure.name])


class Episodes:
    """Table of evaluated episodes of one task, with statistics by policy."""

    def __init__(self, rows: Iterable[Row], measures: Measures) -> None:
        self.rows = list(rows)
        self.measures = measures

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def where(self, keep: Callable[[Row], Any]) -> "Episodes":
        return Episodes(filter(keep, self), self.measures)

    def of(self, policy: str) -> list[Row]:
        return [row for row in self if row["policy"] == policy]

    @cached_property
    def policies(self) -> list[str]:
        return list(dict.fromkeys(row["policy"] for row in self))

    @property
    def reference(self) -> str:
        """Name of the policy that the other policies are compared with."""
        return next((name for name in REFERENCES if name in self.policies), self.policies[0])

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
        return {label: Episodes(rows, self.measures) for label, rows in parts.items()}

    def by_start(self, policy: str) -> dict[tuple[Case, int], Row]:
        return {start_of(row): row for row in self.of(policy)}

    def unseen(self) -> "Episodes":
        """Return only the episodes in worlds or with robots not used in training.

        Empty without learned policies, or if these are all episodes.
        """
        found = self.where(lambda row: is_held_out(row["world"], row["robot"]))
        return found if len(found) < len(self) and any(row["model"] for row in self) else Episodes((), self.measures)

    def shared(self, policies: Iterable[str] = ()) -> "Episodes":
        """Return the episodes with conditions and seeds that all given policies have completed.

        Default: all policies without access to ground truth.
        """
        names = list(policies) or [name for name in self.policies if not is_bound(name)] or self.policies
        starts = set.intersection(*(set(self.by_start(name)) for name in names)) if names else set()
        return self.where(lambda row: start_of(row) in starts)

    def related(self, reference: str | None = None) -> "Episodes":
        """Return the episodes with added columns that relate them to a reference policy's episodes from equal starts.

        `reached` is 1 if the episode reached the first threshold, such as 95 % explored. `relative_*` is the time or
        distance until a threshold, divided by that of the reference policy (its limit if it missed the threshold).
        """
        references = self.by_start(reference or self.reference) if self.rows else {}
        related = []
        for row in self:
            row = row | {one.name: int(np.isfinite(row[self.measures.marks[0].name])) for one in self.measures.reached}
            same_start = references.get(start_of(row), {})
            for mark in self.measures.marks if same_start else ():
                unit, share = value_of(same_start, mark), share_of(mark)
                for name, value in ((share.name, row[mark.name]), (share.limit, row[mark.limit])):
                    # Thresholds reached by the first scan have the value 0.
                    row[name] = value / unit if unit > 0.0 else 1.0
            related.append(row)
        return Episodes(related, self.measures)

    def values(self, policy: str, measure: Measure) -> list[np.ndarray]:
        """Return the values of a measure for a policy: one array per combination of conditions, ordered by seed."""
        return _strata([row for row in self.of(policy) if measure.name in row], measure)

    def pairs(self, a: str, b: str, measure: Measure) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the values of a measure for policies `a` and `b` in episodes with equal conditions and seed.

        Both lists have one array per combination of conditions, in equal order.
        """
        theirs = self.by_start(b)
        shared = [row for row in self.of(a) if measure.name in row and start_of(row) in theirs]
        return _strata(shared, measure), _strata([theirs[start_of(row)] for row in shared], measure)

    def estimate(self, policy: str, measure: Measure) -> Estimate:
        """Return the interquartile mean of a measure for a policy, or the proportion for a binary measure.

        Raises:
            ValueError: if no episode has this measure.
        """
        if measure.is_share:
            return success_rate(self.values(policy, measure))
        mine = [row for row in self.of(policy) if measure.name in row]
        return estimate(_strata(mine, measure), _strata(mine, measure, lambda row, _: np.isfinite(row[measure.name])))

    def summary(self) -> Summary:
        summary: Summary = {policy: {} for policy in self.policies}
        for label, here in self.by_case().items():
            for policy in here.policies:
                summary[policy][label] = {one.name: here.estimate(policy, one) for one in self.measures.all}
        return summary

    def standing(self, measure: Measure) -> dict[str, Estimate]:
        """Return the estimates of a measure by policy, best first; policies with access to ground truth come last."""
        names = dict.fromkeys(row["policy"] for row in self if measure.name in row)
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


def best_of(estimates: Mapping[str, Estimate], measure: Measure) -> set[str]:
    """Return the policies with the best value of a measure, as rounded in tables; empty if all are equal.

    Policies with access to ground truth are ignored.
    """
    shown = {k: (float(measure.text(one.iqm)), one.is_bound[0]) for k, one in estimates.items() if not is_bound(k)}
    if measure.higher_is_better is None or not shown:
        return set()
    best = max(shown.values()) if measure.higher_is_better else min(shown.values())
    winners = {policy for policy, value in shown.items() if value == best}
    return winners if len(winners) < len(shown) else set()
