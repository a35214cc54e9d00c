"""The pages of the report that play recorded episodes."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.arena.page import Cell, Section, Table
from benchmarks.arena.pairs import by_start, case_of, label_cases, policies_of, reference_of, start_of
from benchmarks.arena.recordings import recording_path
from benchmarks.arena.records import Row
from benchmarks.arena.summary import typical_and_worst
from benchmarks.arena.theme import short
from benchmarks.arena.trace import episode_name
from envs.files import write_file
from envs.measures import Measure
from envs.player import Recording, build_page

PAGES = "players"
"""Folder of the pages."""


def players_section(folder: Path, rows: Sequence[Row], headline: Measure) -> Section | None:
    """Write the pages that play each policy's typical and worst recorded episode; return links to them.

    Each page shows the episode beside the reference's from the same start, where that one is recorded.

    Args:
        folder: of the evaluation; holds the recordings, and gets the pages.
        rows: of all episodes.
        headline: of the task.

    Returns:
        The section; None if nothing was recorded.
    """
    recorded = [row for row in rows if recording_path(folder, row).exists()]
    if not recorded:
        return None
    (folder / PAGES).mkdir(exist_ok=True)
    policies, labels = policies_of(recorded), label_cases(rows)
    reference = reference_of(policies)
    references = by_start(recorded, reference)
    lines = []
    for policy in policies:
        cells = [Cell(short(policy))]
        for row in typical_and_worst(recorded, policy, headline):
            other = references.get(start_of(row)) if policy != reference else None
            shown = [row, other] if other else [row]
            page = build_page([Recording.load(recording_path(folder, one)) for one in shown])
            path = folder / PAGES / f"{episode_name(row)}.html"
            write_file(path, page)
            value = f"{headline.label} {headline.text(row[headline.name])} {headline.unit}"
            text = f"{labels[case_of(row)]}, seed {row['seed']}"
            cells.append(Cell(text, value, link=f"{PAGES}/{path.name}"))
        lines.append(cells)
    text = (
        f"Of each policy the episode with the median {headline.label}, and the one with the worst, "
        f"to play and to drag through, beside {short(reference)} from the same start."
    )
    return Section("Episodes to play", (text, Table(("", "typical", "worst"), lines)))
