"""Where a robot takes itself to be, and what it takes its surroundings for."""

from .belief import NO_CELLS, NO_UPDATE, ORIGIN, Belief, MapUpdate, Window
from .estimator import Estimator

__all__ = ["NO_CELLS", "NO_UPDATE", "ORIGIN", "Belief", "Estimator", "MapUpdate", "Window"]
