"""Leaderboard and comparison tables of an evaluation."""

from collections import Counter
from collections.abc import Mapping, Sequence

from lidarnaut.agents.policy_names import is_bound, short
from lidarnaut.agents.statistics import Estimate
from lidarnaut.benchmarks.arena.episodes import Episodes, best_of, start_of
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.page import Cell, Section, Table
from lidarnaut.benchmarks.arena.verdict import ranks
from lidarnaut.envs.measures import Measure

DASH = Cell("-")
DRIFT = 0.3
"""RMS position error above which the report describes a map as drifted [m]."""


def section_of(title: str, text: str, *tables: Table) -> Section:
    """Return a section with `text`, the meaning of bold values if there are some, a table, and one of all measures."""
    has_best = any(cell.is_best for table in tables for line in table.lines for cell in line)
    text = f"{text}{' Bold: better than all others, with intervals apart.' * has_best}".strip()
    return Section(title, (*filter(None, [text]), tables[0], *(Section("All measures", (one,)) for one in tables[1:])))


def marked(estimates: Mapping[str, Estimate], measure: Measure) -> dict[str, Cell]:
    best = best_of(estimates, measure)
    return {policy: Cell.of(value, measure, policy == best) for policy, value in estimates.items()}


def ranked_policies(episodes: Episodes) -> dict[str, str]:
    """Return all policies, best first, with their ranks; last bounds, and policies without a start of the reference."""
    found, rest = ranks(episodes), (*episodes.standing(episodes.measures.decisive), *episodes.policies)
    return found | {name: "bound" if is_bound(name) else "" for name in rest if name not in found}


def ranking_table(episodes: Episodes, shown: Sequence[Measure]) -> Table:
    """Return the leaderboard: one row per policy, and one column per measure.

    A policy alone has times instead of ratios to itself.
    """
    ranked = ranked_policies(episodes)
    names = {policy: f"{rank}: {short(policy)}" if rank else short(policy) for policy, rank in ranked.items()}
    shown = [episodes.measures.times.get(one.name, one) for one in shown] if len(names) == 1 else shown
    columns = [marked(episodes.standing(measure), measure) for measure in shown]
    lines = [[Cell(name), *(column.get(policy, DASH) for column in columns)] for policy, name in names.items()]
    return Table(("", *(measure.title for measure in shown)), lines, is_open=True)


def ranking_sections(episodes: Episodes) -> list[Section]:
    """Return the report sections with the leaderboard.

    If learned policies ran, the first leaderboard covers only worlds and robots not used in training.
    """
    measures, headline = episodes.measures, episodes.measures.headline
    ranked = "Ranks such as 1-3" if any(ranks(episodes).values()) else "No ranks"
    text = f"Ordered by success, then by {measures.decisive.label}. {ranked}: pairs of episodes do not decide."
    text += f" Ratios are to {short(episodes.reference)}'s." * bool(measures.ratios)
    text *= len(episodes.policies) > 1
    if headline.note:
        text += f" {headline.label[:1].upper()}{headline.label[1:]}: {headline.note}."
    if episodes.bound:
        text += " Policies that use ground truth are performance bounds and are not ranked."
    tables = [ranking_table(episodes, names) for names in (measures.shown, measures.all)]
    if not (unseen := episodes.unseen()):
        return [section_of("Leaderboard", text, *tables)]
    number, total = (len(set(map(start_of, part))) for part in (unseen, episodes))
    text += f" These are the {number} starts in worlds or with robots not used in training."
    first = section_of("Leaderboard", text, ranking_table(unseen, measures.shown))
    return [first, section_of(f"All {total} starts, including training worlds", "", *tables)]


def worlds_section(episodes: Episodes) -> Section:
    measure = (*episodes.measures.times.values(), episodes.measures.headline)[0]
    lines = []
    for case, here in episodes.by_case().items():
        cells = marked({policy: here.estimate(policy, measure) for policy in here.policies}, measure)
        lines.append([Cell(case), *(cells.get(policy, DASH) for policy in episodes.policies)])
    unit = f" [{measure.unit}]" * bool(measure.unit)
    text = f"{measure.label[:1].upper()}{measure.label[1:]}{unit}, interquartile mean."
    return section_of("World by world", text, Table(("", *map(short, episodes.policies)), lines))


def axis_section(episodes: Episodes, axis: str) -> Section | None:
    """Return a report section on the effect of one condition, such as SLAM or physics; None if it never varies."""
    measures, values = episodes.measures, list(dict.fromkeys(row[axis] for row in episodes))
    if len(values) < 2:
        return None
    base = "truth" if axis == "slam" and "truth" in values else values[0]
    values.sort(key=lambda value: value != base)
    gaps = *measures.ratios[1:], *measures.gaps
    lines = []
    for policy in episodes.policies:
        versions = [row | {"policy": row[axis], axis: base} for row in episodes.of(policy)]
        shared = Episodes(versions, measures, base).shared(values)
        for value in values if shared else ():
            cells = [Cell.of(shared.estimate(value, m), m) for m in measures.on_axes]
            for measure in gaps:
                sign = "" if measure in measures.ratios else "+"
                cells.append(DASH if value == base else Cell.of(shared.gap(value, base, measure), measure, sign=sign))
            lines.append([Cell(f"{short(policy)}, {value}"), *cells])
    if not lines:
        return None
    text = "The same policies from the same starts. Differences are paired" + (
        f", those of times and distances are ratios to the policy's values under {base}." if measures.ratios else "."
    )
    heads = (f"{m.title} to {base}'s" if m in measures.ratios else f"{m.title}, difference to {base}" for m in gaps)
    errors = "What mapping error costs" if measures.marks else "What pose errors cost"
    title = errors if axis == "slam" else f"Effect of {axis}"
    return Section(title, (text, Table(("", *(m.title for m in measures.on_axes), *heads), lines)))


def unfinished_section(episodes: Episodes) -> Section:
    lines = []
    for policy in episodes.policies:
        for case, here in episodes.like(episodes.of(policy)).by_case().items():
            if failed := [row for row in here if not row["success"]]:
                reasons = Counter(map(explain, failed)).most_common()
                why = "; ".join(f"{reason} ({count})" for reason, count in reasons)
                lines.append([*map(Cell, (short(policy), case, str(len(here)), str(len(failed)), why))])
    if not lines:
        return Section("Not finished", ("No episode failed.",))
    text = f"Failed episodes, and why. A map counts as drifted if the RMS position error exceeds {DRIFT:.1f} m."
    head = ("policy", "world", "episodes", "failed", "why they ended")
    return Section("Not finished", (text, Table(head, lines, words=(1, 4))))


def explain(row: Row) -> str:
    reason = row["end_reason"].replace("_", " ")
    return f"{reason}, and the map had drifted" if row["position_rmse"] > DRIFT else reason
