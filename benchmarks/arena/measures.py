"""The measures that the arena reports of a task's episodes, in the order in which it reports them."""

from collections.abc import Sequence
from dataclasses import replace

from lidarnaut.benchmarks.arena.statistics import Estimate
from lidarnaut.envs.measures import COMMON, SUCCESS, Measure, headline_of

NUM_BRIEF = 5
"""Number of measures in the table of a world in the terminal."""
DECISION = Measure("decision_ms", "decision", "ms", False, digits=2)


class Measures:
    """What is measured of the episodes of a task, and which of it is shown where."""

    def __init__(self, own: Sequence[Measure], progress: str) -> None:
        """Sort the measures that a task declares; `progress` is the entry of `info` whose course is shown."""
        self.own, self.progress = tuple(own), progress
        self.all = (*self.own, *COMMON, DECISION, SUCCESS)
        """Columns of `episodes.csv`, and rows of tables: those of the task, and of all tasks."""
        self.headline = headline_of(self.own)
        """What policies are ranked by: it has no threshold, and every episode has one."""
        others = tuple(measure for measure in self.own if not measure.is_headline)
        self.marks = tuple(measure for measure in self.own if measure.is_relative)
        """Times and distances that are compared as shares of what the reference needed from the same start."""
        self.mark = self.marks[0].label.removeprefix("time to ") if self.marks else ""
        """What the first of them stands for, such as "95 %"."""
        self.relative = tuple(map(share_of, self.marks))
        """These shares (`Episodes.related`): seconds in a maze and in a warehouse are not of a kind."""
        self.reached = (
            Measure("reached", f"{self.mark} reached", "%", True, digits=0, scale=100.0, is_share=True),
        ) * bool(self.marks)
        """Whether the first of the marks was reached; none without marks."""
        self.decisive = (*self.relative, self.headline)[0]
        """What the verdict is about."""
        self.compared = self.headline, *(self.marks or others)
        """In which policies are compared pair by pair in one world."""
        self.gaps = self.headline, *(self.relative or others)
        """In which they are compared over several worlds."""
        main = self._named(self.progress) if self.marks else others
        ends = SUCCESS, *self._named("collisions", "decision_ms")
        self.shown = self.headline, *main, *self.relative, *self.reached, *ends
        """Columns of the leaderboard."""
        self.on_axes = self.headline, *(self.reached or (SUCCESS,)), *self._named("position_rmse", "map_iou")
        """What is shown as it is where the values of an axis are compared."""
        time = next((measure for measure in self.own if measure.limit), SUCCESS)
        safe, common = self._named("collisions"), COMMON[: NUM_BRIEF - 2]
        story = (self.marks[0], *common) if self.marks else (SUCCESS, time, *safe, *others, *common)
        self.brief = tuple(dict.fromkeys((self.headline, *story)))[:NUM_BRIEF]
        """Rows of the table in the terminal: the headline, success or the first mark, times, and common measures."""
        self.label = next((measure.label for measure in self._named(self.progress)), "progress")
        """What the course of `progress` is called."""

    def _named(self, *names: str) -> list[Measure]:
        return [measure for name in names for measure in self.all if measure.name == name]


def share_of(mark: Measure) -> Measure:
    """Return the measure of a mark as a share of what the reference needed."""
    name, label = f"relative_{mark.name}", f"{mark.label}, relative"
    return replace(mark, name=name, label=label, unit="", digits=2, scale=1.0, limit=f"{name}_limit")


def texts(measure: Measure, estimate: Estimate, sign: str = "") -> tuple[str, str]:
    """Return an estimate of a measure and what to print small beside it; `sign="+"` marks it as a difference.

    That is its interval, ("41", "35 to 47"), of which some ends may be lower bounds, ("> 310 s", "250 to > 320"); how
    many episodes got to the mark where all of it is a lower bound, ("> 310 s", "1 of 8"); and the limit that the
    episodes count as where none did, ("never", "> 300 s"); ("> 6.0", "never") for what has no limit of its own.
    """
    numbers = (measure.text(value, sign) for value in estimate[:3])
    middle, low, high = (f"> {text}" if bound else text for text, bound in zip(numbers, estimate.is_bound))
    if estimate.is_bound[0]:
        middle = f"{middle} {measure.unit}".strip()
    if estimate.never == estimate.n:
        return ("never", middle) if measure.limit else (middle, "never")
    return middle, f"{estimate.n - estimate.never} of {estimate.n}" if estimate.is_bound[1] else f"{low} to {high}"
