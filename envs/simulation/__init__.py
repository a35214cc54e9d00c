"""Two physics for one robot, and its sensors."""

from .simulator import Reading, Simulator, TrueState, Twist

__all__ = ["Reading", "Simulator", "TrueState", "Twist"]
