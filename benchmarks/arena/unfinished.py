"""Episodes that did not explore everything or could not be run, and why, as far as the data tell."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

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
HEAD = ("world", "episodes", "below 95 %", "below 99 %", "least explored %", "left on average m²", "why it ended")


def explain(row: Row) -> str:
    """Say in a few words why an episode ended before everything was explored."""
    reason = REASONS.get(row["end_reason"], row["end_reason"].replace("_", " "))
    return f"{reason}, and the map had drifted" if row["position_rmse"] > DRIFT else reason


def unfinished_section(rows: Sequence[Row]) -> Section:
    """Return which episodes did not get to the marks, where, and why."""
    parts: list[str | Table] = [
        f"Every episode that explored less than {100 * MARKS[1]:.0f} %, by explorer and world. A map counts as drifted "
        f"where the root mean square position error exceeds {DRIFT:.1f} m."
    ]
    for policy in policies_of(rows):
        mine = [row for row in rows if row["policy"] == policy]
        lines = []
        for case, here in split(mine).items():
            if left := [row for row in here if row["explored_fraction"] < MARKS[1]]:
                least = 100 * min(row["explored_fraction"] for row in left)
                area = np.mean([row["area_left"] for row in left])
                why = "; ".join(f"{reason} ({count})" for reason, count in Counter(map(explain, left)).most_common())
                line = (case, str(len(here)), *map(str, _below(here)), f"{least:.1f}", f"{area:.1f}", why)
                lines.append([Cell(text) for text in line])
        if lines:
            done, finished = _below(mine)
            title = f"{short(policy)}: of {len(mine)} episodes {done} below 95 %, {finished} below 99 %"
            parts.append(Table(HEAD, lines, words=(6,), title=title))
    if len(parts) == 1:
        parts = ["Every episode explored 99 % or more."]
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
    table = Table(("world and robot", "episodes", "explorers", "why"), lines, words=(2, 3))
    return Section("Not run", (text, table) if lines else (text,))
