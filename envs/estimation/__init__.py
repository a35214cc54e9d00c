"""Pose estimates and maps: beliefs, estimators, sources of motion."""

from .belief import NO_CELLS, NO_UPDATE, ORIGIN, Belief, Correction, Estimator, MapUpdate, Window
from .dead_reckoning import DeadReckoning

__all__ = [
    "NO_CELLS",
    "NO_UPDATE",
    "ORIGIN",
    "Belief",
    "Correction",
    "DeadReckoning",
    "Estimator",
    "MapUpdate",
    "Window",
]
