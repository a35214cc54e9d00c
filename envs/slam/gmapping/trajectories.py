"""The trajectories of all particles."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def _trace(poses, parents, length, particle, out):
    """Write the poses of a particle, shape (length, 3), from the last one back."""
    for k in range(length - 1, -1, -1):
        out[k] = poses[k, particle]
        particle = parents[k, particle]


class Trajectories:
    """Poses at the key scans, as a tree: what particles have in common is kept once."""

    def __init__(self, num_particles: int) -> None:
        self._poses = np.empty((256, num_particles, 3))
        self._parents = np.empty((256, num_particles), dtype=np.int32)
        self._length = 0

    def __len__(self) -> int:
        """Return the number of key scans."""
        return self._length

    def append(self, poses: np.ndarray, parents: np.ndarray) -> None:
        """Add the poses of a key scan.

        Args:
            poses: shape (num_particles, 3), float64, map frame [m, m, rad].
            parents: shape (num_particles,), integer: the particle at the key scan before that each one goes on from.
        """
        if self._length == len(self._poses):
            self._poses = np.concatenate([self._poses, np.empty_like(self._poses)])
            self._parents = np.concatenate([self._parents, np.empty_like(self._parents)])
        self._poses[self._length], self._parents[self._length] = poses, parents
        self._length += 1

    def trace(self, particle: int) -> np.ndarray:
        """Return the trajectory of a particle: shape (number of key scans, 3), float64, map frame [m, m, rad]."""
        out = np.empty((self._length, 3))
        _trace(self._poses, self._parents, self._length, particle, out)
        return out
