"""Episodes that did not do all of their task or could not be run, and why, as far as the data tell."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from benchmarks.arena.measures import Measures
from benchmarks.arena.page import Cell, Section, Table
from benchmarks.arena.pairs import policies_of, split
from benchmarks.arena.records import Row
from benchmarks.arena.runner import NOT_RUN
from benchmarks.arena.theme import short
from benchmarks.arena.workers import Result
from envs.slam import SLAM_NAMES

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
COVERING = f"Every episode that explored less than {100 * MARKS[1]:.0f} %", "Every episode explored 99 % or more."
FAILING = "Every episode without success", "Every episode succeeded."
"""What is listed, and what is said where there is nothing to list."""
DRIFTED = f"A map counts as drifted where the root mean square position error exceeds {DRIFT:.1f} m."
HEAD = ("world", "episodes", "below 95 %", "below 99 %", "least explored %", "left on average m²", "why it ended")


def explain(row: Row) -> str:
    """Say in a few words why an episode ended before its task was done."""
    reason = REASONS.get(row["end_reason"], row["end_reason"].replace("_", " "))
    return f"{reason}, and the map had drifted" if row["position_rmse"] > DRIFT else reason


def unfinished_section(rows: Sequence[Row], measures: Measures) -> Section:
    """Return which episodes did not get to the marks, where, and why; of tasks without coverage, which ones failed."""
    is_covering = "area_left" in {measure.name for measure in measures.own}
    parts: list[str | Table] = [f"{(COVERING if is_covering else FAILING)[0]}, by policy and world. {DRIFTED}"]
    for policy in policies_of(rows):
        mine = [row for row in rows if row["policy"] == policy]
        lines = []
        for case, here in split(mine).items():
            if left := [
                row for row in here if (row["explored_fraction"] < MARKS[1] if is_covering else not row["success"])
            ]:
                why = "; ".join(f"{reason} ({count})" for reason, count in Counter(map(explain, left)).most_common())
                line = [case, str(len(here)), str(len(left)), why]
                if is_covering:
                    least = 100 * min(row["explored_fraction"] for row in left)
                    area = np.mean([row["area_left"] for row in left])
                    line[2:3] = [*map(str, _below(here)), f"{least:.1f}", f"{area:.1f}"]
                lines.append([Cell(text) for text in line])
        if lines:
            counts = "{} below 95 %, {} below 99 %".format(*_below(mine)) if is_covering else ""
            counts = counts or f"{sum(not row['success'] for row in mine)} failed"
            head = HEAD if is_covering else ("world", "episodes", "failed", "why they ended")
            title = f"{short(policy)}: of {len(mine)} episodes {counts}"
            parts.append(Table(head, lines, words=(len(head) - 1,), title=title))
    if len(parts) == 1:
        parts = [(COVERING if is_covering else FAILING)[1]]
    return Section("Not finished", tuple(parts))


def _below(rows: Sequence[Row]) -> list[int]:
    return [sum(row["explored_fraction"] < mark for row in rows) for mark in MARKS]


def group_failures(failures: Sequence[Result]) -> dict[tuple[str, str], tuple[int, str]]:
    """Return by world (with its robot, and an own SLAM) and reason how many episodes could not be run, and of whom."""
    groups: dict[tuple[str, str], list[str]] = {}
    for failure in failures:
        where = f"{failure.key.world} with {failure.key.robot}"
        where += "" if failure.key.slam in SLAM_NAMES else f" and {failure.key.slam}"
        groups.setdefault((where, failure.reason), []).append(short(failure.key.policy))
    return {group: (len(names), ", ".join(dict.fromkeys(names))) for group, names in groups.items()}


def missing_section(missing: Sequence[Result], num_rows: int, num_fair: int) -> Section | None:
    """Return the episodes that could not be run, and why; None if none is missing.

    Args:
        missing: the episodes.
        num_rows: episodes that there are.
        num_fair: those of them from starts that all competitors share.
    """
    if not missing:
        return None
    lines = []
    for (where, reason), (number, who) in group_failures([one for one in missing if one.reason != NOT_RUN]).items():
        lines.append([Cell(where), Cell(str(number)), Cell(who), Cell(reason)])
    untried = sum(one.reason == NOT_RUN for one in missing)
    text = f"{len(missing)} episodes are missing, {untried} of them were {NOT_RUN}. " if untried else ""
    text += f"The leaderboard counts the starts that all competitors have: {num_fair} of {num_rows} episodes."
    table = Table(("world and robot", "episodes", "policies", "why"), lines, words=(2, 3))
    return Section("Not run", (text, table) if lines else (text,))
