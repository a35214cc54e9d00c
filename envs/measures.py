"""Measures of an episode, such as success and times."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeHistory:
    """Recorded `info` of an episode: n samples, at the reset and after every step."""

    samples: Mapping[str, np.ndarray]
    """Samples by name of an `info` entry, each of shape (n, ...), float64; teams have an axis for robots."""
    final: Mapping[str, Any]
    """Last `info`, including `end_reason`."""
    time_limit: float
    """Time limit of the episode [s]."""
    max_speed: float
    """Maximum forward speed of the robot [m/s]."""

    def of(self, name: str) -> np.ndarray:
        """Return the samples of an `info` entry, summed over robots; shape (n,), float64."""
        samples = self.samples[name]
        return samples.reshape(len(samples), -1).sum(axis=1)


class HistoryRecorder:
    """Records the numeric entries of `info` at every step."""

    def __init__(self) -> None:
        self._rows: list[list[Any]] = []
        self._names: list[str] = []

    def watch(self, info: Mapping[str, Any]) -> None:
        if not self._rows:
            numbers = {name: value for name, value in info.items() if not isinstance(value, list | tuple | dict)}
            self._names = [name for name, value in numbers.items() if np.asarray(value).dtype.kind in "biuf"]
        self._rows.append([info.get(name, math.nan) for name in self._names])

    def history(self, final: Mapping[str, Any], time_limit: float, max_speed: float) -> EpisodeHistory:
        columns = zip(*self._rows, strict=True)
        samples = {name: np.array(column, dtype=np.float64) for name, column in zip(self._names, columns, strict=True)}
        return EpisodeHistory(samples, final, time_limit, max_speed)


@dataclass(frozen=True, slots=True)
class Measure:
    """Definition of a measure of episodes: name, computation, unit and table format."""

    name: str
    """Column of `episodes.csv`, and key in `summary.json`."""
    label: str
    unit: str
    higher_is_better: bool | None
    """Whether higher values are better; None for a neutral measure."""
    compute: Callable[[EpisodeHistory], float] = None  # type: ignore[assignment]
    """Function that returns the value of an episode, infinite if a threshold was never reached. Default: the entry
    `name` of the last `info`."""
    digits: int = 1
    scale: float = 1.0
    """Factor from the SI unit of the data to `unit`."""
    is_share: bool = False
    """Whether values are 0 or 1, so that their mean is a share of episodes."""
    limit: str = ""
    """Column of `episodes.csv` that replaces infinite values, such as "time_limit"; empty if never infinite."""
    is_headline: bool = False
    """Whether this (headline) measure ranks policies. Requires a value in every episode."""
    is_relative: bool = False
    """Whether reports also divide values by those of the reference policy from the same start. Requires `limit`."""
    note: str = ""
    """Explanation printed with rankings, without a final period."""

    def __post_init__(self) -> None:
        if self.compute is None:
            object.__setattr__(self, "compute", partial(final, name=self.name))

    @property
    def title(self) -> str:
        return f"{self.label} {self.unit}".strip()

    def text(self, value: float, sign: str = "") -> str:
        """Return a value in `unit`, rounded for a table; "never" if infinite. `sign="+"` adds plus signs."""
        if math.isinf(value):
            return "never"
        rounded = float(f"{value * self.scale:.{self.digits}f}") + 0.0  # no negative zero
        return f"{rounded:{sign}.{self.digits}f}"


def final(history: EpisodeHistory, name: str) -> float:
    """Return an entry of the last `info`, summed over robots."""
    return float(np.sum(history.final[name]))


def when(history: EpisodeHistory, name: str, mark: float, quantity: str = "time") -> float:
    """Return a quantity, by default time [s], when an `info` entry first reaches `mark`; infinite if never."""
    reached = history.of(name) >= mark
    return float(history.of(quantity)[reached.argmax()]) if reached.any() else math.inf


def when_successful(history: EpisodeHistory, quantity: str = "time") -> float:
    """Return the final value of a quantity, by default time [s], if an episode is successful; otherwise infinity."""
    return final(history, quantity) if history.final["is_success"] else math.inf


def mean_over_limit(history: EpisodeHistory, name: str) -> float:
    """Return the time average of an `info` entry over the time limit; ended episodes keep their last value."""
    values, time, limit = history.of(name), history.of("time"), history.time_limit
    known = np.trapezoid(values, time) + values[-1] * max(0.0, limit - time[-1])
    return float(known / max(limit, time[-1]))


def root_mean_square(history: EpisodeHistory, name: str, column: int | None = None) -> float:
    """Return the root mean square of an `info` entry (or of its column `column`) over samples and robots."""
    means = np.mean(np.square(history.samples[name]), axis=0)
    return float(np.sqrt(np.mean(means if column is None else means[..., column])))


_pose_rmse = partial(root_mean_square, name="pose_error")
SUCCESS = Measure("success", "success", "%", True, partial(final, name="is_success"), 0, 100.0, is_share=True)
"""Success, a measure of every task: `is_success` of the last `info`."""
TIME_TO_SUCCESS = Measure("time_to_success", "time to success", "s", False, when_successful, limit="time_limit")
"""Default measure of tasks: time to success [s]."""
COMMON = (
    Measure("path_length", "path", "m", None),
    Measure("collisions", "collisions", "", False),
    Measure("position_rmse", "position error", "cm", False, partial(_pose_rmse, column=0), scale=100.0),
    Measure("heading_rmse", "heading error", "deg", False, partial(_pose_rmse, column=1), 2, math.degrees(1.0)),
)
"""Measures of every task: path length, collisions, and RMS pose errors."""


def measures_of(measures: Sequence[Measure]) -> tuple[Measure, ...]:
    """Return all measures of a task: its own, then the measures that all tasks have."""
    return (*measures, *COMMON, SUCCESS)


def headline_of(measures: Sequence[Measure]) -> Measure:
    """Return the headline measure, which ranks policies; success by default."""
    return next((measure for measure in measures if measure.is_headline), SUCCESS)


_explored_at = partial(when, name="explored_fraction")
_reached_95 = partial(_explored_at, mark=0.95)
_path_to_95 = partial(_reached_95, quantity="path_length")
_mean = partial(mean_over_limit, name="explored_fraction")
_NOTE = "the mean explored share over the whole time limit, which rewards being early as well as being complete"
EXPLORATION = (
    Measure("explored_fraction", "explored", "%", True, scale=100.0),
    Measure("time_to_90", "time to 90 %", "s", False, partial(_explored_at, mark=0.90), 0, limit="time_limit"),
    Measure("time_to_95", "time to 95 %", "s", False, _reached_95, 0, limit="time_limit", is_relative=True),
    Measure("time_to_99", "time to 99 %", "s", False, partial(_explored_at, mark=0.99), 0, limit="time_limit"),
    Measure("distance_to_95", "distance to 95 %", "m", False, _path_to_95, limit="distance_limit", is_relative=True),
    Measure("area_under_curve", "area under curve", "%", True, _mean, scale=100.0, is_headline=True, note=_NOTE),
    Measure("map_iou", "map IoU", "%", True, scale=100.0),
    Measure("area_left", "unexplored area", "m²", False),
)
"""Measures of exploration: coverage, times and distance to coverage thresholds, map quality."""


def time_home(history: EpisodeHistory) -> float:
    """Return the duration of the drive home [s]; infinite if the robot did not return."""
    return final(history, "time_home") if history.final["returned"] else math.inf


RETURN = (
    Measure("returned", "returned", "%", True, digits=0, scale=100.0, is_share=True),
    Measure("time_home", "drive home", "s", False, time_home, limit="time_limit"),
)
"""Measures of the return to the start after exploration."""


def path_efficiency(history: EpisodeHistory) -> float:
    """Return success weighted by path length (SPL): 0 on failure, else shortest / driven length.

    Anderson et al., "On Evaluation of Embodied Navigation Agents" (2018), section 3.2.
    """
    shortest = float(history.samples["geodesic_distance"][0])
    return float(history.final["is_success"]) * shortest / max(final(history, "path_length"), shortest, 1e-9)


GOAL = (
    Measure("spl", "success by path length", "%", True, path_efficiency, 1, 100.0, is_headline=True),
    Measure("time_to_goal", "time to the goal", "s", False, when_successful, limit="time_limit"),
    Measure("way_left", "distance left", "m", False, partial(final, name="geodesic_distance"), 2),
)
"""Measures of navigation to a goal; `info` must contain `geodesic_distance` to the goal [m]."""
DOCK = (
    *GOAL,
    Measure("distance_to_goal", "offset", "cm", False, scale=100.0),
    Measure("heading_error", "offset of the heading", "deg", False, digits=2, scale=math.degrees(1.0)),
    Measure("charge", "charge", "%", True, scale=100.0),
)
"""Measures of docking: those of goals, final offsets from the docked pose, and charge of the battery."""


def sct(history: EpisodeHistory) -> float:
    """Return success weighted by completion time (SCT): 0 on failure, else ideal / actual time.

    The ideal time is that of the shortest path at maximum speed.
    """
    ideal = float(history.samples["geodesic_distance"][0]) / history.max_speed
    return float(history.final["is_success"]) * ideal / max(final(history, "time"), ideal, 1e-9)


def barn_metric(is_success: bool, time: float, ideal: float) -> float:
    """Return the metric of the BARN challenge: success x OT / clip(AT, 2 OT, 8 OT), at most 0.5.

    AT is the time since the robot first moved [s], OT the ideal time [s]. Source: README of Daffan/the-barn-challenge.
    The paper has the limit 4 OT: Xiao et al., "Autonomous Ground Navigation in Highly Constrained Spaces" (2022).
    """
    return is_success * ideal / min(max(time, 2.0 * ideal), 8.0 * ideal) if ideal > 0.0 else 0.0


REACH = (
    Measure("sct", "SCT", "%", True, sct, 1, 100.0, is_headline=True),
    replace(GOAL[0], is_headline=False),
    *GOAL[1:],
    Measure("barn_metric", "BARN metric", "", True, digits=4),
    Measure("jerk", "jerk", "m/s³", False),
)
"""Measures of goal reaching: success, path and time efficiency, BARN metric and jerk."""
_swept = partial(mean_over_limit, name="swept_fraction")
_swept_90 = partial(when, name="swept_fraction", mark=0.9)
SWEEP = (
    Measure("swept_fraction", "swept", "%", True, scale=100.0),
    Measure("time_to_90", "time to 90 %", "s", False, _swept_90, 0, limit="time_limit"),
    Measure("area_under_curve", "area under curve", "%", True, _swept, scale=100.0, is_headline=True),
)
"""Measures of sweeping: swept fraction of the floor, and its increase over time."""
PEOPLE = (
    Measure("hit_person", "drove into people", "", False, digits=2),
    Measure("hit_by_person", "people walked into it", "", None, digits=2),
    Measure("hit_wall", "other contacts", "", False, digits=2),
    Measure("intrusion_time", "time in personal space", "s", False),
    Measure("least_gap", "least gap to people", "m", True, digits=2),
    Measure("least_time_to_collision", "least time to collision", "s", True),
)
"""Measures of tasks with people: contacts, time in personal space, smallest gap and time to collision.

Personal space ends 0.45 m from a person's surface (Hall, "The Hidden Dimension", 1966). Gaps are at most 10 m, times to
collision (at constant velocities) at most 10 s."""


def route_driven(history: EpisodeHistory) -> float:
    """Return the completed fraction of the route; 1 on success."""
    return max(final(history, "progress"), float(history.final["is_success"]))


_deviation_rmse = partial(root_mean_square, name="deviation")
ROUTE = (
    Measure("progress", "route driven", "%", True, route_driven, 1, 100.0, is_headline=True),
    Measure("deviation_rmse", "deviation from the route", "cm", False, _deviation_rmse, scale=100.0),
    Measure("time_to_end", "time to the end", "s", False, when_successful, limit="time_limit"),
)
"""Measures of route following: completed fraction, deviation and time."""
