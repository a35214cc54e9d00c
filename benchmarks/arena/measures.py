"""Selection of the performance measures in each table and figure of an evaluation."""

from collections.abc import Sequence
from dataclasses import replace

from lidarnaut.agents.statistics import Estimate
from lidarnaut.envs.measures import COMMON, SUCCESS, Measure, headline_of

NUM_BRIEF = 4
"""Maximum number of measures printed in the terminal for a single world."""
MIN_STARTS = 5
"""Minimum number of starts of each policy for a verdict. Tables mark intervals of fewer: the bootstrap of few values
gives too narrow ones."""
DECISION = Measure("decision_ms", "decision", "ms", False, digits=2)


class Measures:
    """Performance measures of a task, grouped by the tables and figures that show them."""

    def __init__(self, own: Sequence[Measure], progress: str) -> None:
        """Sort the measures of a task, `own`, by use in reports; `progress` is the `info` key of task progress."""
        self.own, self.progress = tuple(own), progress
        self.all = (*self.own, *COMMON, DECISION, SUCCESS)
        """All measures, in the column order of `episodes.csv`."""
        self.headline = headline_of(self.own)
        """Measure that ranks the policies."""
        others = tuple(measure for measure in self.own if not measure.is_headline)
        self.marks = tuple(measure for measure in self.own if measure.is_relative)
        """Measures of the time or distance until a threshold, such as 95 % explored; empty without a threshold."""
        self.mark = self.marks[0].label.removeprefix("time to ") if self.marks else ""
        self.relative = tuple(map(share_of, self.marks))
        """Times or distances until the threshold, divided by those of the reference policy."""
        reached = Measure("reached", f"{self.mark} reached", "%", True, digits=0, scale=100.0, is_share=True)
        self.reached = (reached,) * bool(self.marks)
        """Measure of success: 1 if an episode reached the task's progress threshold (such as 95 % explored), else 0."""
        self.decisive = (*self.relative, self.headline)[0]
        """Measure that decides which policy the summary names as best."""
        self.gaps = self.headline, *(self.relative or others)
        """Measures shown in comparisons of pairs of policies."""
        main = self._named(self.progress) if self.marks else others
        ends = SUCCESS, *self._named("collisions", "decision_ms")
        self.shown = self.headline, *main, *self.relative, *self.reached, *ends
        """Measures shown as columns of the leaderboard."""
        self.on_axes = self.headline, *(self.reached or (SUCCESS,)), *self._named("position_rmse", "map_iou")
        """Measures shown in comparisons of SLAMs, simulators or crowds."""
        time = next((measure for measure in self.own if measure.limit), SUCCESS)
        safe, common = self._named("collisions"), COMMON[: NUM_BRIEF - 2]
        story = (self.marks[0], *common) if self.marks else (SUCCESS, time, *safe, *others, *common)
        self.brief = tuple(dict.fromkeys((self.headline, *story)))[:NUM_BRIEF]
        """Main measures, printed by default: the headline, then the first threshold, or success and its time."""
        self.label = next((measure.label for measure in self._named(self.progress)), "progress")
        """Axis label of plots of task progress, such as "explored"."""

    def _named(self, *names: str) -> list[Measure]:
        return [measure for name in names for measure in self.all if measure.name == name]


def share_of(mark: Measure) -> Measure:
    """Return a new measure: the time or distance measure `mark`, divided by its value for the reference policy."""
    name, label = f"relative_{mark.name}", f"{mark.label}, relative"
    return replace(mark, name=name, label=label, unit="", digits=2, scale=1.0, limit=f"{name}_limit")


def texts(measure: Measure, estimate: Estimate, sign: str = "") -> tuple[str, str]:
    """Format an estimate for a table cell: text and note, such as ("41", "35 to 47") with the 95 % interval as note.

    If some episodes missed a threshold, the text is a lower bound ("> 310 s"), and the note counts those that reached
    it ("1 of 8"). If all missed it, one of the two is "never". Intervals of few values say so ("35 to 47; only 2
    starts"). `sign="+"` adds a plus sign to positive values.
    """
    numbers = (measure.text(value, sign) for value in estimate[:3])
    middle, low, high = (f"> {text}" if bound else text for text, bound in zip(numbers, estimate.is_bound))
    if estimate.is_bound[0]:
        middle = f"{middle} {measure.unit}".strip()
    if estimate.never == estimate.n:
        return ("never", middle) if measure.limit else (middle, "never")
    if estimate.is_bound[1]:
        return middle, f"{estimate.n - estimate.never} of {estimate.n}"
    few = few_starts(estimate.n)
    return middle, few[2:] if few and estimate.low == estimate.high else f"{low} to {high}{few}"


def few_starts(number: int) -> str:
    """Return the note on an interval of `number` starts; empty if they are enough for a verdict."""
    return "" if number >= MIN_STARTS else f"; only {number} start{'s' * (number != 1)}"
