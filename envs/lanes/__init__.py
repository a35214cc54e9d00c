"""Many kinematic robots side by side in one process."""

from .kernels import finish_lanes, step_lanes
from .records import Lanes, Numbers, Scratch, Views

__all__ = ["Lanes", "Numbers", "Scratch", "Views", "finish_lanes", "step_lanes"]
