"""What an axis such as the SLAM costs explorers: the same starts under each of its values, pair by pair."""

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.arena.measures import BY_NAME
from benchmarks.arena.pairs import by_start, paired_values, policies_of, pool, relate
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, paired_difference

EASIEST = {"slam": "truth"}
"""Values that the others of their axis are compared with; where it is not among them, the first one."""
SHOWN = tuple(BY_NAME[name] for name in ("area_under_curve", "reached_95", "position_rmse", "map_iou"))
"""Measures that are shown as they are."""
COMPARED = tuple(BY_NAME[name] for name in ("area_under_curve", "relative_time", "relative_distance"))
"""Measures of which the differences are shown, pair by pair."""


@dataclass(frozen=True, slots=True)
class AxisEntry:
    """An explorer under one value of an axis."""

    policy: str
    value: str
    """Value of the axis."""
    base: str
    """Value that it is compared with."""
    worlds: tuple[str, ...]
    """Worlds with starts that all values share."""
    estimates: dict[str, Estimate]
    """By the names of `SHOWN`."""
    differences: dict[str, Estimate]
    """To the base, by the names of `COMPARED`; those of times and distances as shares of the base's. Empty for the
    base itself."""


def compare_axis(rows: Sequence[Row], axis: str) -> list[AxisEntry]:
    """Compare the values of an axis with its base, for every policy, on the starts that all of them have.

    Args:
        rows: episodes.
        axis: column.
    """
    values = list(dict.fromkeys(row[axis] for row in rows))
    if not values:
        return []
    base = EASIEST[axis] if EASIEST.get(axis) in values else values[0]
    ordered = [base, *(value for value in values if value != base)]
    entries = []
    for policy in policies_of(rows):
        # Under each value it stands for a policy of its own, from the same starts.
        versions = [row | {"policy": row[axis], axis: base} for row in rows if row["policy"] == policy]
        starts = set.intersection(*(set(by_start(versions, value)) for value in ordered))
        shared = [row for value in ordered for start, row in by_start(versions, value).items() if start in starts]
        for value in ordered if shared else ():
            entries.append(_entry(relate(shared, base), policy, value, base))
    return entries


def _entry(versions: Sequence[Row], policy: str, value: str, base: str) -> AxisEntry:
    differences = {}
    if value != base:
        differences = {m.name: paired_difference(*paired_values(versions, value, base, m)) for m in COMPARED}
    estimates = {m.name: pool(versions, value, m) for m in SHOWN}
    worlds = tuple(dict.fromkeys(row["world"] for row in versions))
    return AxisEntry(policy, value, base, worlds, estimates, differences)
