"""The measures of the tasks."""

import math
from functools import partial

from envs.measures import Course, Measure, final, mean_over_limit, root_mean_square, when, when_successful

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
"""How much was explored, and when."""


def time_home(course: Course) -> float:
    """Return how long the drive back to the start took [s]; infinite if the robot did not return."""
    return final(course, "time_home") if course.final["returned"] else math.inf


RETURN = (
    Measure("returned", "returned", "%", True, digits=0, scale=100.0, is_share=True),
    Measure("time_home", "drive home", "s", False, time_home, limit="time_limit"),
)
"""Whether the robot came back to its start after exploring."""


def path_efficiency(course: Course) -> float:
    """Return success weighted by path length: 0 without success, else shortest length over the length driven.

    Anderson et al., "On Evaluation of Embodied Navigation Agents" (2018), section 3.2.
    """
    shortest = float(course.samples["geodesic_distance"][0])
    return float(course.final["is_success"]) * shortest / max(final(course, "path_length"), shortest, 1e-9)


GOAL = (
    Measure("spl", "success by path length", "%", True, path_efficiency, 1, 100.0, is_headline=True),
    Measure("time_to_goal", "time to the goal", "s", False, when_successful, limit="time_limit"),
    Measure("way_left", "distance left", "m", False, partial(final, name="geodesic_distance"), 2),
)
"""Whether a goal was reached, how directly and when; `info` needs `geodesic_distance` to it [m]."""


def route_driven(course: Course) -> float:
    """Return the share of the route that was driven; it ends a little before the end of its line."""
    return max(final(course, "progress"), float(course.final["is_success"]))


_deviation_rmse = partial(root_mean_square, name="deviation")
ROUTE = (
    Measure("progress", "route driven", "%", True, route_driven, 1, 100.0, is_headline=True),
    Measure("deviation_rmse", "deviation from the route", "cm", False, _deviation_rmse, scale=100.0),
    Measure("time_to_end", "time to the end", "s", False, when_successful, limit="time_limit"),
)
"""How near to a route the robot drove, and how far."""
