"""Pose estimates and maps: beliefs, estimators, sources of motion."""

from .belief import NO_CELLS, NO_UPDATE, ORIGIN, Belief, MapUpdate, Window
from .estimator import Estimator

__all__ = ["NO_CELLS", "NO_UPDATE", "ORIGIN", "Belief", "Estimator", "MapUpdate", "Window"]
