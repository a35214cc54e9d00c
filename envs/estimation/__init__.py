"""Pose estimates, maps, odometry and people tracking."""

from .belief import NO_CELLS, NO_UPDATE, Belief, Correction, Estimator, MapUpdate

__all__ = ["NO_CELLS", "NO_UPDATE", "Belief", "Correction", "Estimator", "MapUpdate"]
