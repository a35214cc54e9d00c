"""Summary of an evaluation: best policy and margin, as a sentence and a figure."""

from collections.abc import Mapping

from lidarnaut.agents.policy_names import short
from lidarnaut.agents.statistics import Estimate, paired_difference
from lidarnaut.baselines import ALL
from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.measures import MIN_STARTS, texts
from lidarnaut.benchmarks.arena.page import Figure, Section
from lidarnaut.benchmarks.arena.plots import draw_values, render
from lidarnaut.envs.measures import Measure

NUM_NAMED = 3
"""Maximum number of policies that the summary names as tied with the best."""


def verdict_section(episodes: Episodes) -> Section | None:
    """Return a report section that names the best policy; None with fewer than two ranked policies."""
    measures, measure = episodes.measures, episodes.measures.decisive
    if len(episodes.competitors(measure)) < 2:
        return None
    text, where = verdict(episodes), ""
    if unseen := episodes.unseen():
        where = ", in worlds or with robots not used in training"
        text = f"{where[2:].capitalize()}: {verdict(unseen)} Including training worlds: {text}"
        episodes = unseen
    values, reference = episodes.competitors(measure), episodes.reference
    first = next(iter(values.values()))
    if first.never == first.n or _least(values) < MIN_STARTS:
        return Section("At a glance", (text,))
    levels, title, best, better = {}, measure.title, "best", "better"
    if measures.marks:
        levels, best, better = {f"{short(reference)} = 1": 1.0}, "fastest", "faster"
        title = f"time to {measures.mark} as a share of {short(reference)}'s"
    if bound := _bound(episodes, measure):
        levels[f"ground truth: {texts(measure, bound[1])[0]}"] = measure.scale * bound[1].iqm
    drawn = {}
    for policy, value in values.items():
        middle, low, high = (measure.scale * number for number in value[:3])
        drawn[policy] = Estimate(middle, low, high, value.n), _value(value, measure)
    best_ones = [next(iter(values)), *_tied(episodes, values, measure)]
    picture = render(draw_values, drawn, best_ones, levels, title, bool(measures.marks))
    caption = (
        f"{title[:1].upper()}{title[1:]}{' from the same start' if measures.marks else ''}{where}: interquartile "
        f"means, 95 % intervals. Further {'right' if measure.higher_is_better else 'left'} is {better}. Blue: the "
        f"{best} policy, and policies that cannot be distinguished from it."
    )
    return Section("At a glance", (text, Figure("verdict", picture, caption, is_wide=True)))


def verdict(episodes: Episodes) -> str:
    """Summarize an evaluation in a sentence: best policy, tied policies, and result of the ground-truth policy.

    Policies are tied if the 95 % interval of their paired difference contains 0. It takes `MIN_STARTS` starts of each.
    """
    measures, measure, mark = episodes.measures, episodes.measures.decisive, episodes.measures.mark
    values = episodes.competitors(measure)
    leader, *others = values
    number, value = values[leader].n, _value(values[leader], measure)
    if mark and values[leader].never == number:
        return f"No policy reached {mark} from any of the {number} starts within the time limit."
    if (least := _least(values)) < MIN_STARTS:
        shared = f"the policies have only {least} start{'s' * (least != 1)} in common"
        return f"No verdict: {shared}; at least {MIN_STARTS} are needed."
    found = f"{measure.label} {value} over {number} starts"
    if mark:
        found = f"{mark} in {value} of {short(episodes.reference)}'s time over {number} starts"
    if mark and leader == episodes.reference:
        found = f"no other policy is faster to {mark} over {number} starts"
    best, has = ("is fastest", "needs") if mark else ("does best", "has")
    if tied := _tied(episodes, values, measure):
        names = [f"{short(policy)} ({_value(values[policy], measure)})" for policy in tied[:NUM_NAMED]]
        names += [f"{len(tied) - NUM_NAMED} more"] if len(tied) > NUM_NAMED else []
        listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
        parts = [f"{short(leader)} is ahead: {found}", f"it cannot be distinguished from {listed}"]
    else:
        parts = [f"{short(leader)} {best}: {found}"]
    rivals = [policy for policy in others if leader in ALL or policy in ALL]
    if rivals and not set(rivals) & set(tied):
        who = "the next policy" if leader in ALL else "the best classic policy"
        parts.append(f"{who}, {short(rivals[0])}, {has} {_value(values[rivals[0]], measure)}")
    if bound := _bound(episodes, measure):
        parts.append(f"the bound, {bound[0]}, is {_value(bound[1], measure)}")
    text = f"{'; '.join(parts)}."
    if (first := next(iter(episodes.standing(measures.headline)))) != leader:
        text += f" By {measures.headline.label}, the ranking measure of the leaderboard, {short(first)} is first."
    return text


def _bound(episodes: Episodes, measure: Measure) -> tuple[str, Estimate] | None:
    return next((item for item in episodes.standing(measure).items() if item[0] == episodes.bound), None)


def _least(values: Mapping[str, Estimate]) -> int:
    return min(value.n for value in values.values())


def _tied(episodes: Episodes, values: Mapping[str, Estimate], measure: Measure) -> list[str]:
    leader, *others = values
    sign = 1.0 if measure.higher_is_better else -1.0
    gaps = {policy: paired_difference(*episodes.pairs(policy, leader, measure)) for policy in others}
    return [policy for policy, gap in gaps.items() if max(sign * gap.low, sign * gap.high) >= 0.0]


def _value(estimate: Estimate, measure: Measure) -> str:
    middle, note = texts(measure, estimate)
    middle = f"{middle} {measure.unit}".strip()
    if estimate.low == estimate.high and estimate.n >= MIN_STARTS:
        return middle
    return f"{middle} [{note.replace(' to ', ', ')}]" if " to " in note else f"{middle} ({note})"
