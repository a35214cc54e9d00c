"""Pose estimates, maps, odometry and people tracking."""

from .belief import NO_CELLS, NO_UPDATE, ORIGIN, Belief, Correction, Estimator, MapUpdate, Window

__all__ = ["NO_CELLS", "NO_UPDATE", "ORIGIN", "Belief", "Correction", "Estimator", "MapUpdate", "Window"]
