"""Where an explorer could go: one place to stand per frontier."""

import numpy as np

from baselines.goal_explorer import Goal
from baselines.survey import Survey
from baselines.viewpoints import find_viewpoint
from envs.navigation import TravelField

VIEW_DISTANCES = (0.0, 0.3, 0.6, 1.0)
"""How far from a frontier the robot may stand to see it; the first one from which it can is taken [m]."""


def goal_for(survey: Survey, field: TravelField, cells: np.ndarray) -> Goal | None:
    """Return the cheapest place to see one of some frontier cells from, as near to it as the robot gets.

    Args:
        survey: the map.
        field: ways from the robot.
        cells: shape (k, 2), int64, (row, column) of what to see.

    Returns:
        The goal; None if the robot can get near none of the cells.
    """
    for distance in VIEW_DISTANCES:
        found = find_viewpoint(field, cells, distance)
        if found is not None:
            place, seen = found
            x, y = survey.grid.centers(cells[seen])
            return Goal(place, (float(x), float(y)))
    return None
