"""Selection of the performance measures in each table and figure of an evaluation."""

from collections.abc import Sequence
from dataclasses import replace

from lidarnaut.agents.statistics import Estimate
from lidarnaut.envs.measures import COMMON, PEOPLE, SUCCESS, TIME_TO_SUCCESS, Measure, headline_of

NUM_BRIEF = 4
"""Maximum number of measures printed in the terminal for a single world."""
MIN_STARTS = 5
"""Minimum number of starts of each policy for a verdict. Tables mark intervals of fewer: the bootstrap of few values
gives too narrow ones."""
DECISION = Measure("decision_ms", "decision", "ms", False, digits=2)


class Measures:
    """Performance measures of a task, grouped by the tables and figures that show them."""

    def __init__(self, own: Sequence[Measure], progress: str, success: str = "the task is completed") -> None:
        """Sort the measures of a task, `own`, by use in reports.

        `progress` is the `info` key of task progress, `success` the condition of success in words.
        """
        self.own, self.progress, self.success = tuple(own), progress, success
        self.all = (*self.own, *COMMON, DECISION, SUCCESS)
        """All measures, in the column order of `episodes.csv`."""
        self.headline = headline_of(self.own)
        """Measure that ranks the policies in the leaderboard."""
        others = tuple(measure for measure in self.own if not measure.is_headline)
        self.marks = tuple(measure for measure in self.own if measure.is_relative)
        """Measures of the time or distance until a threshold, such as 95 % explored; empty without a threshold."""
        times = (TIME_TO_SUCCESS, *self.marks) if self.marks else ()
        self.ratios = tuple(map(ratio_of, times))
        """Times or distances until success or a threshold, divided by those of the reference from the same start."""
        self.times = {ratio.name: time for ratio, time in zip(self.ratios, times)}
        """Measures that `ratios` divide, by the name of the ratio."""
        time = next((measure for measure in self.own if measure.limit), SUCCESS)
        self.criteria = tuple(dict.fromkeys((SUCCESS, *self.ratios[:2], self.headline, *(() if times else (time,)))))
        """Measures that the summary ranks policies by, first success."""
        self.decisive = (*self.criteria, SUCCESS)[1]
        """Measure that ranks policies of equal success, and the leaderboard."""
        self.gaps = self.headline, *(() if times else others)
        """Measures whose differences are shown in comparisons of pairs of policies; ratios are shown too."""
        safe = self._named("collisions", "hit_person", "intrusion_time")
        minor = {"way_left", *(one.name for one in (time, *safe, *PEOPLE))}
        further = [one for one in others if one.name not in minor][:2]  # The rest are below "All measures".
        rest = [*self._named(self.progress), *safe] if times else [time, *safe, *further]
        self.shown = tuple(dict.fromkeys((SUCCESS, *self.ratios, self.headline, *rest)))
        """Measures shown as columns of the leaderboard."""
        self.on_axes = tuple(dict.fromkeys((SUCCESS, self.headline, *self._named("position_rmse", "map_iou"))))
        """Measures shown in comparisons of SLAMs, simulators or crowds."""
        self.brief = tuple(self.times.get(measure.name, measure) for measure in self.shown[:NUM_BRIEF])
        """Main measures, printed by default for a single world."""
        self.label = next((measure.label for measure in self._named(self.progress)), "progress")
        """Axis label of plots of task progress, such as "explored"."""

    def _named(self, *names: str) -> list[Measure]:
        return [measure for name in names for measure in self.all if measure.name == name]


def ratio_of(time: Measure) -> Measure:
    """Return a measure of the ratio of `time`, a time or distance until a threshold, to that of a reference policy."""
    label = f"{time.label.removesuffix(', ratio')}, ratio"
    return replace(time, name=f"{time.name}_ratio", label=label, unit="", digits=2, scale=1.0)


def texts(measure: Measure, estimate: Estimate, sign: str = "", mark: str = "") -> tuple[str, str]:
    """Format an estimate for a table cell: text and note, such as ("41", "35 to 47") with the 95 % interval as note.

    If some episodes missed a threshold, the text is a lower bound ("> 310 s"), and the note counts those that reached
    it ("1 of 8"). If all missed it, one of the two is "never". Intervals of few values say so ("35 to 47; only 2
    starts"), or end with `mark`. `sign="+"` adds a plus sign to positive values.
    """
    numbers = (measure.text(value, sign) for value in estimate[:3])
    middle, low, high = (f"> {text}" if bound else text for text, bound in zip(numbers, estimate.is_bound))
    if estimate.is_bound[0]:
        middle = f"{middle} {measure.unit}".strip()
    if estimate.never == estimate.n:
        return ("never", middle) if measure.limit else (middle, "never")
    if estimate.is_bound[1]:
        return middle, f"{estimate.n - estimate.never} of {estimate.n}"
    few = few_starts(estimate.n) and (mark or few_starts(estimate.n))
    return middle, few.removeprefix("; ") if few and estimate.low == estimate.high else f"{low} to {high}{few}"


def few_starts(number: int) -> str:
    """Return the note on an interval of `number` starts; empty if they are enough for a verdict."""
    return "" if number >= MIN_STARTS else f"; only {number} start{'s' * (number != 1)}"
