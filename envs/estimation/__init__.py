"""Pose estimates, maps, odometry and people tracking."""

from .belief import NO_CELLS, NO_UPDATE, Belief, Correction, DeadReckoning, Estimator, MapUpdate

__all__ = ["NO_CELLS", "NO_UPDATE", "Belief", "Correction", "DeadReckoning", "Estimator", "MapUpdate"]
