"""Navigation to goals: the classic policies of `lidarnaut/Navigate-v0`, reactive driving while the robot is lost."""

from .goal_driver import GoalDriver
from .map_navigator import MapNavigator
from .params import MapNavigatorParams

__all__ = ["GoalDriver", "MapNavigator", "MapNavigatorParams"]
