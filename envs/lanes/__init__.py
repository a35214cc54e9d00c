"""Many kinematic robots side by side in one process."""

from .kernels import draw_and_view, move_and_locate
from .records import Lanes, Numbers, Scratch, Views

__all__ = ["Lanes", "Numbers", "Scratch", "Views", "draw_and_view", "move_and_locate"]
