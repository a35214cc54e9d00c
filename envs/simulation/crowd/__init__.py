"""People that walk, give way to robots, or do not."""

from .params import CROWDS, Crowd, crowd_of
from .people import People

__all__ = ["CROWDS", "Crowd", "People", "crowd_of"]
