"""Leaderboard and comparison tables of an evaluation."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lidarnaut.agents.policy_names import is_bound, short
from lidarnaut.agents.statistics import Estimate, paired_difference, probability_of_improvement
from lidarnaut.benchmarks.arena.episodes import Episodes, best_of, raw_value, start_of
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.page import Cell, Section, Table
from lidarnaut.envs.measures import SUCCESS, Measure

DASH = Cell("-")
MARKS = (0.95, 0.99)
"""Explored fractions; the report counts the episodes that end below each of them."""
DRIFT = 0.3
"""RMS position error above which the report describes a map as drifted [m]."""
REASONS = {
    "time_limit": "time ran out",
    "no_reachable_frontier": "no reachable frontier left on its map",
    "stuck": "could not move any more",
}


def marked(estimates: Mapping[str, Estimate], measure: Measure) -> dict[str, Cell]:
    best = best_of(estimates, measure)
    return {policy: Cell.of(value, measure, policy == best) for policy, value in estimates.items()}


def policies_table(episodes: Episodes, shown: Sequence[Measure], names: Mapping[str, str], **how: Any) -> Table:
    """Return a table with a row for each policy of `names` and a column for each measure."""
    columns = [marked(episodes.standing(measure), measure) for measure in shown]
    lines = [[Cell(name), *(column.get(policy, DASH) for column in columns)] for policy, name in names.items()]
    return Table(("", *(measure.title for measure in shown)), lines, **how)


def ranked_policies(episodes: Episodes) -> list[str]:
    """Return all policies by the decisive measure, last those without a start in common with the reference."""
    return [*dict.fromkeys((*episodes.standing(episodes.measures.decisive), *episodes.policies))]


def ranking_table(episodes: Episodes, shown: Sequence[Measure]) -> Table:
    """Return the leaderboard: one row per policy, ranked by the decisive measure, and one column per measure."""
    ranked = enumerate(ranked_policies(episodes), start=1)
    names = {policy: f"{'bound:' if is_bound(policy) else f'{k}.'} {short(policy)}" for k, policy in ranked}
    return policies_table(episodes, shown, names, is_open=True)


def ranking_sections(episodes: Episodes) -> list[Section]:
    """Return the report sections with the leaderboard.

    If learned policies ran, the first leaderboard covers only worlds and robots not used in training.
    """
    measures, headline = episodes.measures, episodes.measures.headline
    text = (
        f"Ranked by {measures.decisive.label}. Bold: better than all others, with intervals apart. Interquartile means "
        "over all starts with 95 % stratified bootstrap intervals; proportions have Wilson intervals."
    )
    if headline.note:
        text += f" {headline.label[:1].upper()}{headline.label[1:]}: {headline.note}."
    if measures.ratios:
        text += (
            f" Ratios are geometric means over pairs of episodes with {short(episodes.reference)} from the same start; "
            "a threshold that was not reached counts as the limit (>)."
        )
    if episodes.bound:
        text += " Policies that use ground truth are performance bounds and are not ranked."
    if not (unseen := episodes.unseen()):
        return [Section("Leaderboard", (text, ranking_table(episodes, measures.shown)))]
    number, total = (len(set(map(start_of, part))) for part in (unseen, episodes))
    text += f" These are the {number} starts in worlds or with robots not used in training."
    return [
        Section("Leaderboard", (text, ranking_table(unseen, measures.shown))),
        Section(f"All {total} starts, including training worlds", (ranking_table(episodes, measures.shown),)),
    ]


def measures_section(episodes: Episodes) -> Section:
    others = [measure for measure in episodes.measures.all if measure not in episodes.measures.shown]
    text = (
        "Interquartile means over the same starts as above. Times and distances of small and large worlds are pooled: "
        "compare policies, not absolute values."
    )
    names = {policy: short(policy) for policy in ranked_policies(episodes)}
    return Section("All other measures", (text, policies_table(episodes, others, names)))


def pairs_section(episodes: Episodes) -> Section | None:
    """Return a report section that compares each policy with the reference policy under equal conditions and seeds."""
    reference, measures = episodes.reference, episodes.measures
    lines = []
    for policy in ranked_policies(episodes):
        if policy == reference or not episodes.by_start(policy).keys() & episodes.by_start(reference).keys():
            continue
        cells = [Cell.of(episodes.estimate(policy, ratio), replace(ratio, digits=3)) for ratio in measures.ratios]
        pairs = [episodes.pairs(policy, reference, measure) for measure in measures.gaps]
        gaps = [Cell.of(paired_difference(*pair), one, sign="+") for pair, one in zip(pairs, measures.gaps)]
        better = probability_of_improvement(*pairs[0], bool(measures.headline.higher_is_better))
        lines.append([Cell(short(policy)), *cells, Cell.of(better, SUCCESS), *gaps])
    if not lines:
        return None
    reference = short(reference)
    text = (
        f"Ratios and differences (interquartile means) to {reference} from the same start, and the probability of "
        f"improvement: the share of starts with a better {measures.headline.label}; ties count half."
    )
    head = ("", *(f"{ratio.label} to {reference}'s" for ratio in measures.ratios), "improvement %")
    head += tuple(f"{measure.title}, difference" for measure in measures.gaps)
    return Section("Pair by pair", (text, Table(head, lines)))


def worlds_section(episodes: Episodes) -> Section:
    measure = (*episodes.measures.times.values(), episodes.measures.headline)[0]
    lines = []
    for case, here in episodes.by_case().items():
        cells = marked({policy: here.estimate(policy, measure) for policy in here.policies}, measure)
        for policy, cell in cells.items() if measure.limit else ():
            reached = [np.isfinite(raw_value(row, measure)) for row in here.of(policy)]
            if any(reached):
                note = "" if all(reached) else f"{sum(reached)} of {len(reached)}"
                cells[policy] = cell._replace(note=note)
        lines.append([Cell(case), *(cells.get(policy, DASH) for policy in episodes.policies)])
    unit = f" [{measure.unit}]" if measure.unit else ""
    text = f"{measure.label[:1].upper()}{measure.label[1:]}{unit}, interquartile mean."
    if measure.limit:
        text += (
            " If not all episodes reached the threshold, their number is shown next to the mean, which is a lower "
            "bound (>) if it depends on the other episodes. If none did, the limit is shown."
        )
    return Section("World by world", (text, Table(("", *map(short, episodes.policies)), lines)))


def axis_section(episodes: Episodes, axis: str) -> Section | None:
    """Return a report section on the effect of one condition, such as SLAM or physics; None if it never varies."""
    measures, values = episodes.measures, list(dict.fromkeys(row[axis] for row in episodes))
    if len(values) < 2:
        return None
    base = "truth" if axis == "slam" and "truth" in values else values[0]
    values.sort(key=lambda value: value != base)
    gaps = *measures.ratios[1:], *measures.gaps
    lines, worlds, num_starts = [], dict[str, None](), 0
    for policy in episodes.policies:
        versions = [row | {"policy": row[axis], axis: base} for row in episodes.of(policy)]
        shared = Episodes(versions, measures, base).shared(values)
        worlds |= dict.fromkeys(row["world"] for row in shared)
        num_starts = num_starts or len(shared.by_start(base))
        for value in values if shared else ():
            cells = [Cell.of(shared.estimate(value, m), m) for m in measures.on_axes]
            for measure in gaps:
                sign = "" if measure in measures.ratios else "+"
                cells.append(DASH if value == base else Cell.of(shared.gap(value, base, measure), measure, sign=sign))
            lines.append([Cell(f"{short(policy)}, {value}"), *cells])
    if not lines:
        return None
    text = f"The same policies from the same {num_starts} starts in {', '.join(worlds)}. Differences are paired" + (
        f", those of times and distances are ratios to the policy's values under {base}." if measures.ratios else "."
    )
    heads = (f"{m.title} to {base}'s" if m in measures.ratios else f"{m.title}, difference to {base}" for m in gaps)
    errors = "What mapping error costs" if measures.marks else "What pose errors cost"
    title = errors if axis == "slam" else f"Effect of {axis}"
    return Section(title, (text, Table(("", *(m.title for m in measures.on_axes), *heads), lines)))


def unfinished_section(episodes: Episodes) -> Section:
    is_covering = "area_left" in {measure.name for measure in episodes.measures.own}
    lines = []
    for policy in episodes.policies:
        for case, here in episodes.like(episodes.of(policy)).by_case().items():
            left = [row for row in here if (row["explored_fraction"] < MARKS[1] if is_covering else not row["success"])]
            if not left:
                continue
            reasons = Counter(map(explain, left)).most_common()
            line = [short(policy), case, str(len(here)), str(len(left))]
            if is_covering:
                line.insert(3, str(sum(row["explored_fraction"] < MARKS[0] for row in left)))
                line.append(f"{100 * min(row['explored_fraction'] for row in left):.1f}")
                line.append(f"{np.mean([row['area_left'] for row in left]):.1f}")
            lines.append([*map(Cell, line), Cell("; ".join(f"{reason} ({count})" for reason, count in reasons))])
    failing = f"explored less than {100 * MARKS[1]:.0f} %" if is_covering else "failed"
    if not lines:
        return Section("Not finished", (f"No episode {failing}.",))
    text = f"Episodes that {failing}, and why. A map counts as drifted if the RMS position error exceeds {DRIFT:.1f} m."
    numbers = ("below 95 %", "below 99 %", "least explored %", "left on average m²") if is_covering else ("failed",)
    head = ("policy", "world", "episodes", *numbers, "why they ended")
    return Section("Not finished", (text, Table(head, lines, words=(1, len(head) - 1))))


def explain(row: Row) -> str:
    reason = REASONS.get(row["end_reason"], row["end_reason"].replace("_", " "))
    return f"{reason}, and the map had drifted" if row["position_rmse"] > DRIFT else reason
