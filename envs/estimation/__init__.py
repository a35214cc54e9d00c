"""Pose estimates, maps, odometry and people tracking."""

from lidarnaut.envs.geometry import ORIGIN

from .belief import NO_CELLS, NO_UPDATE, Belief, Correction, Estimator, MapUpdate

__all__ = ["NO_CELLS", "NO_UPDATE", "ORIGIN", "Belief", "Correction", "Estimator", "MapUpdate"]
