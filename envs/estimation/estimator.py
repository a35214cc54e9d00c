"""What SLAM, localization and mapping with known poses have in common."""

from typing import Any, Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.simulation import Reading

from .belief import ORIGIN, Belief


class Estimator(Protocol):
    """Turns readings and motions into a belief. Constructed with the lidar's geometry and the algorithm's parameters.

    An estimator whose `reset` integrates scans into a map that it is given, and that has this map as `map`, sets
    `shares_maps = True`, and serves several robots with one map. One that looks at scans from the first motion on,
    and not at that of the reset, sets `uses_first_scan = False`. Where a task gives the covariance of the initial pose,
    `reset` gets it as `covariance`, shape (3, 3), float64 [m, m, rad].
    """

    @property
    def belief(self) -> Belief:
        """The current belief."""
        ...

    def reset(self, rng: np.random.Generator, pose: Any = ORIGIN, map: Any = None) -> Belief:
        """Start an episode.

        Args:
            rng: later noise is drawn from it.
            pose: `Pose2D` of the robot, map frame; None for anywhere on a known map.
            map: to go on with; None for an unknown one.
        """
        ...

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process one reading.

        Args:
            reading: what the sensors say now; most estimators look at its `ranges` alone.
            motion: pose of the base now, as its motion source sees it from the base at the previous reading.
        """
        ...
