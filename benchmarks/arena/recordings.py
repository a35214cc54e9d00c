"""Recordings of episodes in the folder of an evaluation."""

from typing import Any

from benchmarks.arena.measures import Measures
from benchmarks.arena.policies import short
from benchmarks.arena.records import Row

LEFT_OUT = ("decision_ms", "success")
"""Measures that a recording does not hold: the first one differs from run to run, the second is told by the end."""


def describe(row: Row, measures: Measures) -> dict[str, Any]:
    """Return what a recording says about a row's episode, see `envs.player.Recording.about`."""
    figures = {}
    for measure in measures.all:
        if measure.name not in LEFT_OUT:
            title = f"{measure.label} [{measure.unit}]" if measure.unit else measure.label
            figures[title] = measure.text(row[measure.name]).removesuffix(".0" if measure.name == "collisions" else "-")
    about = {"explorer": short(row["policy"])} | {name: row[name] for name in ("world", "robot", "seed")}
    about["progress"] = measures.label
    ended = {"duration [s]": f"{row['duration']:.0f}", "ended by": row["end_reason"].replace("_", " ")}
    return about | {"end_reason": row["end_reason"], "figures": figures | ended}
