"""Episodes that did not explore everything, and why, as far as the data tell."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.arena.pairs import policies_of
from benchmarks.arena.records import Row
from benchmarks.arena.summary import split

MARKS = (0.95, 0.99)
"""Explored fractions that count as done and as finished."""
DRIFT = 0.3
"""From this position error on [m] a map is taken to have drifted: it is wider than a wall, and than most robots."""
REASONS = {
    "time_limit": "time ran out",
    "no_reachable_frontier": "no reachable frontier left on its map",
    "stuck": "could not move any more",
}
"""What end reasons mean."""


@dataclass(frozen=True, slots=True)
class Unfinished:
    """The episodes of an explorer in a case that did not reach the last mark."""

    policy: str
    case: str
    """Label of the world, and of what else distinguishes it."""
    episodes: int
    """Episodes in all."""
    below: tuple[int, ...]
    """How many stayed below each of `MARKS`."""
    reasons: str
    """Why they ended, and how many."""
    area_left: float
    """Explorable area that they left unknown, on average [m2]."""
    least_explored: float
    """The lowest explored fraction."""


def find_unfinished(rows: Sequence[Row]) -> list[Unfinished]:
    """Return what was not finished, by explorer and case."""
    found = []
    for policy in policies_of(rows):
        for case, here in split([row for row in rows if row["policy"] == policy]).items():
            below = [[row for row in here if row["explored_fraction"] < mark] for mark in MARKS]
            left = below[-1]
            if left:
                reasons = Counter(map(explain, left)).most_common()
                found.append(
                    Unfinished(
                        policy,
                        case,
                        len(here),
                        tuple(map(len, below)),
                        "; ".join(f"{reason} ({count})" for reason, count in reasons),
                        float(np.mean([row["area_left"] for row in left])),
                        min(row["explored_fraction"] for row in left),
                    )
                )
    return found


def explain(row: Row) -> str:
    """Say in a few words why an episode ended before everything was explored."""
    reason = REASONS.get(row["end_reason"], row["end_reason"].replace("_", " "))
    return f"{reason}, and the map had drifted" if row["position_rmse"] > DRIFT else reason
