"""Summary of an evaluation: the best policies by success and other measures, and comparisons of any two policies."""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from string import ascii_letters

from lidarnaut.agents.policy_names import short
from lidarnaut.agents.statistics import Estimate
from lidarnaut.baselines import ALL
from lidarnaut.benchmarks.arena.episodes import Episodes, start_of
from lidarnaut.benchmarks.arena.measures import MIN_STARTS, ratio_of, texts
from lidarnaut.benchmarks.arena.page import Cell, Figure, Part, Section, Table
from lidarnaut.benchmarks.arena.plots import draw_values, render
from lidarnaut.envs.measures import SUCCESS, Measure

NUM_NAMED = 3
"""Maximum number of policies that a sentence names."""
RESOLUTION = 0.05
"""Half width of an interval, relative to the value, that the estimated number of starts would resolve."""


class Order:
    """Ranking of policies without access to ground truth by a measure."""

    def __init__(self, episodes: Episodes, measure: Measure, policies: Sequence[str] = ()) -> None:
        """Rank the given policies, by default all without access to ground truth."""
        self.episodes, self.measure = episodes, measure
        standing = episodes.competitors(measure)
        self.values = {policy: value for policy, value in standing.items() if not policies or policy in policies}
        """Estimates by policy, best first."""
        self.leader, *self.others = self.values
        self.tied = [one for one in self.others if side(episodes.gap(self.leader, one, measure), measure) <= 0]
        """Policies not shown to be worse than the first: the interval of the paired comparison contains 1 or 0."""
        first = self.values[self.leader]
        self.is_reached = first.iqm > 0.0 if measure.is_share else first.never < first.n
        """Whether any policy reached the threshold, or succeeded."""

    @property
    def best(self) -> list[str]:
        return [self.leader, *self.tied]

    def named(self, policy: str) -> str:
        return f"{short(policy)} ({value_text(self.values[policy], self.measure)})"

    def success(self) -> str:
        """Return the policies that succeed most often, as a sentence."""
        worse = [policy for policy in self.others if policy not in self.tied]
        if not self.is_reached:
            return "No policy succeeded."
        if not worse:
            if self.values[self.leader].iqm == self.values[self.others[-1]].iqm:
                return f"All policies succeed alike often: {value_text(self.values[self.leader], self.measure)}."
            return f"No policy is shown to succeed more often: {listed([*map(self.named, self.values)])}."
        verb = "succeed" if self.tied else "succeeds"
        return f"{listed([*map(self.named, self.best)])} {verb} most often; less: {listed([*map(self.named, worse)])}."

    def sentence(self) -> str:
        """Return the first policy, those not shown to be worse, a classic rival and the bound, as a sentence."""
        episodes, measure, leader = self.episodes, self.measure, self.leader
        if not self.is_reached:
            return "No policy reached it."
        of = f" of {short(episodes.reference)}'s" if measure.name in episodes.measures.times else ""
        has = f"{measure.label.removesuffix(', ratio')} {value_text(self.values[leader], measure)}{of}"
        if self.tied:
            near = listed([*map(self.named, self.tied)])
            parts = [f"{short(leader)} is first: {has}", f"not shown to be worse: {near}"]
        else:
            parts = [f"{short(leader)} is best: {has}"]
        rivals = [policy for policy in self.others if leader in ALL or policy in ALL]
        if rivals and not set(rivals) & set(self.tied):
            parts.append(f"{'the next' if leader in ALL else 'the best classic policy'} is {self.named(rivals[0])}")
        if bound := bound_of(episodes, measure):
            parts.append(f"the bound, {episodes.bound}, has {value_text(bound, measure)}")
        return f"{'; '.join(parts)}."

    def certainty(self) -> str:
        """Return the comparison with the closest rival, and the number of starts for `RESOLUTION`, as a sentence."""
        if not self.others:
            return ""
        rival, measure, who = (*self.tied, *self.others)[0], self.measure, short(self.leader)
        gap, kind = self.episodes.gap(self.leader, rival, measure), "ratio" if measure.limit else "difference"
        text = f"In {gap.n} pairs, the {kind} of {who} to {short(rival)} is {value_text(gap, measure, gap)}"
        whole = gap.iqm if measure.limit else abs(self.values[self.leader].iqm)
        if not self.tied or whole <= 0.0 or gap.low == gap.high:
            return f"{text}."
        wanted = math.ceil(gap.n * ((gap.high - gap.low) / (2.0 * RESOLUTION * whole)) ** 2)
        starts = "these starts resolve" if wanted <= gap.n else f"about {wanted} starts would resolve"
        return f"{text}; {starts} {100.0 * RESOLUTION:.0f} %."


def side(gap: Estimate, measure: Measure) -> int:
    """Return 1 or -1 if the interval of a paired comparison, see `Episodes.gap`, lies on the better or worse side."""
    equal, sign = 1.0 if measure.limit else 0.0, 1 if measure.higher_is_better else -1
    return sign * ((gap.low > equal) - (gap.high < equal))


@lru_cache(8)
def ranks(episodes: Episodes) -> dict[str, str]:
    """Return the ranks of the policies without access to ground truth, best first, such as "1", "2-4", "2-4", "3-4".

    A policy is ahead if it succeeds more often, else if it is better by the decisive measure: intervals of the paired
    comparisons decide. Ranks are empty texts if none decides, or with fewer than `MIN_STARTS` starts.
    """
    names = [*episodes.competitors(episodes.measures.decisive)]
    ahead, behind = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for a, b in combinations(names, 2) if names and num_starts(episodes) >= MIN_STARTS else ():
        sides = (side(episodes.gap(a, b, one), one) for one in (SUCCESS, episodes.measures.decisive))
        if decided := next(filter(None, sides), 0):
            winner, loser = (a, b) if decided > 0 else (b, a)
            ahead[loser], behind[winner] = ahead[loser] + 1, behind[winner] + 1
    if not any(ahead.values()):
        return dict.fromkeys(names, "")
    ends = {name: (1 + ahead[name], len(names) - behind[name]) for name in names}
    return {name: "-".join(map(str, dict.fromkeys(ends[name]))) for name in sorted(names, key=ends.__getitem__)}


def verdict_section(episodes: Episodes) -> Section:
    """Return a report section that names the best policies."""
    if len(episodes.competitors(SUCCESS)) < 2:
        (name, value), *_ = episodes.standing(SUCCESS).items()
        success = f"{value_text(value, SUCCESS)} of {value.n} starts succeed ({episodes.measures.success})"
        others = "other policies are better" + ", or how it does in other worlds" * (len(episodes.by_case()) < 2)
        return Section("At a glance", (f"{short(name)} alone: {success}. Nothing shows whether {others}.",))
    text, where = verdict(episodes), ""
    if unseen := episodes.unseen():
        where = ", in worlds or with robots not used in training"
        text = f"{where[2:].capitalize()}: {verdict(unseen)} Including training worlds: {text}"
        episodes = unseen
    parts: list[Part] = [text]
    if num_starts(episodes) >= MIN_STARTS:
        orders = {measure.name: Order(episodes, measure) for measure in episodes.measures.criteria}
        telling = [order for order in orders.values() if len(order.tied) < len(order.others)]
        if len({order.leader for order in telling}) > 1:
            lines = [[Cell(order.measure.label), Cell(order.sentence())] for order in telling]
            parts += ["The best policy depends on the measure:", Table(("by", "result"), lines, words=(1,))]
        if (order := orders[episodes.measures.decisive.name]).is_reached:
            parts.append(_figure(order, where))
        parts.append(_matrix(order))
    return Section("At a glance", tuple(parts))


def verdict(episodes: Episodes) -> str:
    """Summarize an evaluation: policies that succeed most often, the best of them, and the certainty of the order.

    Policies are tied if the 95 % interval of their paired comparison contains 1 (ratio) or 0 (difference). Fewer than
    `MIN_STARTS` starts give no verdict.
    """
    success, *others = episodes.measures.criteria
    if (number := num_starts(episodes)) < MIN_STARTS:
        shared = f"the policies have only {number} start{'s' * (number != 1)} in common"
        return f"No verdict: {shared}; at least {MIN_STARTS} are needed, so policies are not ranked."
    first = Order(episodes, success)
    parts = [f"{number} starts; success: {episodes.measures.success}.", first.success()]
    is_level = len(first.best) > 1 and first.is_reached
    parts += [] if is_level or not first.is_reached else [first.certainty()]
    orders = (Order(episodes, measure, first.best if is_level else ()) for measure in others)
    if order := next((one for one in orders if one.is_reached), None):
        among = "Of these, " if len(order.values) < len(first.values) else ""
        parts += [f"{among}{order.sentence()}", order.certainty()]
    return " ".join(filter(None, parts))


def bound_of(episodes: Episodes, measure: Measure) -> Estimate | None:
    return episodes.standing(measure).get(episodes.bound or "")


def num_starts(episodes: Episodes) -> int:
    """Return the number of starts that all policies without access to ground truth share."""
    return len(set.intersection(*(set(map(start_of, episodes.of(policy))) for policy in episodes.competitors(SUCCESS))))


def listed(names: Sequence[str]) -> str:
    shown = [*names[:NUM_NAMED], *([f"{len(names) - NUM_NAMED} more"] if len(names) > NUM_NAMED else [])]
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))


def value_text(estimate: Estimate, measure: Measure, gap: Estimate | None = None) -> str:
    """Return an estimate of a measure, or of a paired comparison `gap`, with its interval in brackets."""
    measure = ratio_of(measure) if gap and measure.limit else measure
    middle, note = texts(measure, estimate, "+" if gap and not measure.limit else "")
    middle = f"{middle} {measure.unit}".strip()
    if estimate.low == estimate.high and estimate.n >= MIN_STARTS:
        return middle
    return f"{middle} [{note.replace(' to ', ', ')}]" if " to " in note else f"{middle} ({note})"


def _figure(order: Order, where: str) -> Figure:
    episodes, measure, levels, drawn = order.episodes, order.measure, dict[str, float](), {}
    title, is_ratio = measure.title, measure.name in episodes.measures.times
    if is_ratio:
        title = f"{title} to {short(episodes.reference)}'s"
        levels[f"{short(episodes.reference)} = 1"] = 1.0
    if bound := bound_of(episodes, measure):
        levels[f"ground truth: {measure.text(bound.iqm)}"] = measure.scale * bound.iqm
    for policy, value in order.values.items():
        middle, low, high = (measure.scale * number for number in value[:3])
        drawn[policy] = Estimate(middle, low, high, value.n), value_text(value, measure)
    picture = render(draw_values, drawn, order.best, levels, title, is_ratio)
    caption = (
        f"{title[:1].upper()}{title[1:]}{where}, with 95 % intervals. Further "
        f"{'right' if measure.higher_is_better else 'left'} is better. Blue: the first policy, and those not shown to "
        "be worse in pairs of episodes from the same start."
    )
    return Figure("verdict", picture, caption, is_wide=True)


def _matrix(order: Order) -> Section:
    """Return a folded table that compares any two policies."""
    measure, names, lines = order.measure, [*order.values], list[list[Cell]]()
    shown, sign, equal = (ratio_of(measure), "", 1) if measure.limit else (measure, "+", 0)
    letters = [*ascii_letters, *map(str, range(len(names)))][: len(names)]
    for letter, a in zip(letters, names, strict=True):
        gaps = [None if a == b else order.episodes.gap(a, b, measure) for b in names]
        cells = [Cell("") if gap is None else Cell.of(gap, shown, side(gap, measure) > 0, sign) for gap in gaps]
        lines.append([Cell(f"{letter}: {short(a)}"), *cells])
    text = (
        f"{shown.label[:1].upper()}{shown.label[1:]}{', difference' * (not equal)} of the row's policy to the "
        f"column's, from the same {num_starts(order.episodes)} starts, with 95 % intervals."
    )
    if any(cell.is_best for line in lines for cell in line):
        text += f" Bold: the row's policy is better; the interval does not contain {equal}."
    return Section("Any two policies", (text, Table(("", *letters), lines, is_open=True)))
