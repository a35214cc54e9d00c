"""The measures that the arena reports of a task's episodes, in the order in which it reports them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from benchmarks.arena.statistics import Estimate
from envs.measures import COMMON, SUCCESS, Measure, headline_of
from envs.task import Task

DECISION = Measure("decision_ms", "decision", "ms", False, digits=2)


@dataclass(frozen=True)
class Measures:
    """What is measured of the episodes of a task, and which of it is shown where."""

    own: tuple[Measure, ...]
    """Those that the task declares."""
    progress: str
    """Entry of `info` whose course is shown; see `Task`."""

    @classmethod
    def of(cls, task: Task) -> "Measures":
        """Return the measures of a task's episodes."""
        return cls(tuple(task.measures), task.progress)

    @property
    def all(self) -> tuple[Measure, ...]:
        """Columns of `episodes.csv`, and rows of tables: those of the task, and of all tasks."""
        return (*self.own, *COMMON, DECISION, SUCCESS)

    @property
    def headline(self) -> Measure:
        """What policies are ranked by: it has no threshold, and every episode has one."""
        return headline_of(self.own)

    @property
    def marks(self) -> tuple[Measure, ...]:
        """Times and distances that are compared as shares of what the reference needed from the same start."""
        return tuple(measure for measure in self.own if measure.is_relative)

    @property
    def relative(self) -> tuple[Measure, ...]:
        """These shares (`Episodes.related`): seconds in a maze and in a warehouse are not of a kind."""
        return tuple(map(share_of, self.marks))

    @property
    def mark(self) -> str:
        """What the first of the marks stands for, such as "95 %"; empty without marks."""
        return next((mark.label.removeprefix("time to ") for mark in self.marks), "")

    @property
    def reached(self) -> tuple[Measure, ...]:
        """Whether the first of the marks was reached; none without marks."""
        measure = Measure("reached", f"{self.mark} reached", "%", True, digits=0, scale=100.0, is_share=True)
        return (measure,) if self.marks else ()

    @property
    def decisive(self) -> Measure:
        """What the verdict is about: the first of the shares, or else the headline."""
        return next(iter(self.relative), self.headline)

    @property
    def timed(self) -> Measure:
        """What is shown world by world: the first of the marks, or else the headline."""
        return next(iter(self.marks), self.headline)

    @property
    def gaps(self) -> tuple[Measure, ...]:
        """In which policies are compared pair by pair over several worlds."""
        return self.headline, *(self.relative or self._others)

    @property
    def compared(self) -> tuple[Measure, ...]:
        """In which they are compared in one world."""
        return self.headline, *(self.marks or self._others)

    @property
    def shown(self) -> tuple[Measure, ...]:
        """Columns of the leaderboard."""
        main = self._named(self.progress) if self.marks else self._others
        return (
            *(self.headline, *main, *self.relative, *self.reached),
            *(SUCCESS, *self._named("collisions", "decision_ms")),
        )

    @property
    def on_axes(self) -> tuple[Measure, ...]:
        """What is shown as it is where the values of an axis are compared."""
        return self.headline, *(self.reached or (SUCCESS,)), *self._named("position_rmse", "map_iou")

    @property
    def label(self) -> str:
        """What the course of `progress` is called."""
        return next((measure.label for measure in self._named(self.progress)), "progress")

    @property
    def _others(self) -> list[Measure]:
        return [measure for measure in self.own if not measure.is_headline]

    def _named(self, *names: str) -> Iterable[Measure]:
        return (measure for name in names for measure in self.all if measure.name == name)


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
