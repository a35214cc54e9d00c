"""Pose estimates and maps: beliefs, estimators, sources of motion."""

from .belief import NO_CELLS, NO_UPDATE, ORIGIN, Belief, Correction, Estimator, MapUpdate

__all__ = ["NO_CELLS", "NO_UPDATE", "ORIGIN", "Belief", "Correction", "Estimator", "MapUpdate"]
