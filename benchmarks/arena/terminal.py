"""Results in the terminal."""

from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table

from benchmarks.arena.measures import BY_NAME, MEASURES, Measure
from benchmarks.arena.ranking import Entry
from benchmarks.arena.statistics import Estimate
from benchmarks.arena.summary import Summary, best_of
from benchmarks.arena.theme import short


def terminal_table(summary: Summary, case: str) -> Table:
    """Lay out a case's estimates: a row per measure, a column per policy."""
    policies = [policy for policy in summary if case in summary[policy]]
    table = _table(f"{case}, {max(summary[policy][case]['explored_fraction'].n for policy in policies)} episodes")
    for policy in policies:
        table.add_column(policy, justify="right", overflow="fold")
    for measure in MEASURES:
        estimates = {policy: summary[policy][case][measure.name] for policy in policies}
        cells = _cells(estimates, measure)
        table.add_row(f"{measure.label} [dim]{measure.unit}[/dim]", *(cells[policy] for policy in policies))
    return table


def ranking_table(entries: Sequence[Entry]) -> Table:
    """Lay out the head of the leaderboard: a row per policy, a column per measure."""
    table = _table("All worlds")
    cells = {}
    for name in ("area_under_curve", "relative_time", "reached_95"):
        measure = BY_NAME[name]
        table.add_column(f"{measure.title}", justify="right")
        cells[name] = _cells({e.policy: e.estimates[name] for e in entries if name in e.estimates}, measure)
    for entry in entries:
        rank = f"{entry.rank}." if entry.rank else "bound:"
        table.add_row(f"{rank} {short(entry.policy)}", *(column.get(entry.policy, "") for column in cells.values()))
    return table


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    return table


def _cells(estimates: Mapping[str, Estimate], measure: Measure) -> dict[str, str]:
    best = best_of(dict(estimates), measure)
    cells = {}
    for policy, value in estimates.items():
        middle, interval = measure.texts(value)
        cells[policy] = f"{f'[bold]{middle}[/bold]' if policy in best else middle} [dim]({interval})[/dim]"
    return cells
