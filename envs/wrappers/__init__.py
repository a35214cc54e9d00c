"""Environment wrappers."""

from .goal_env import GoalEnv
from .record_bag import BagRecorder, RecordBag

__all__ = ["BagRecorder", "GoalEnv", "RecordBag"]
