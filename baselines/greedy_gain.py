"""Greedy information gain: to wherever the most unknown area would come into view, however far it is."""

import numpy as np

from baselines.candidates import goal_for
from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.survey import Survey
from baselines.visible_gain import visible_gains
from envs.navigation import frontier_clusters

SIZES = (8, 3)
"""Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached."""


class GreedyGainExplorer(GoalExplorer):
    """Goes to the frontier with the most unknown area in the lidar's range; of equal ones to the cheaper."""

    def _choose(self, survey: Survey) -> Goal | None:
        field = survey.field
        if field is None:
            return None
        clusters = frontier_clusters(survey.frontier)
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES):
            for size in SIZES:
                found = [goal_for(survey, field, cells) for cells in clusters if len(cells) >= size]
                goals = [goal for goal in found if goal and self._num_failures(goal.frontier) <= allowed_failures]
                if goals:
                    places = np.array([goal.cell for goal in goals])
                    gains = visible_gains(survey.grid, places, self._robot.lidar.range_max)
                    return goals[np.lexsort((field.cost(places), -gains))[0]]
        return None
