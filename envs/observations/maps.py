"""Egocentric crops of the map."""

import numpy as np
from gymnasium import spaces

from envs.robot import Robot
from envs.robots import RobotParams


class MapCrop:
    """The robot's map around it: axis 1 points forward, axis 2 to the left, the robot in the middle.

    Channels: 0 occupied, 1 free, 2 where a robot has been. Unknown is 0 in channels 0 and 1.
    """

    def __init__(self, resolution: float, size: int = 40) -> None:
        """Choose what to show.

        Args:
            resolution: side of a pixel [m].
            size: pixels along each side. Both checkers of environments (Gymnasium, stable-baselines3) want 36 or more.

        Raises:
            ValueError: one of them is not positive.
        """
        if not resolution > 0 or size < 1:
            raise ValueError(f"a map crop needs a positive resolution and size, got {resolution!r} and {size!r}")
        self.resolution = resolution
        """Side of a pixel [m]."""
        self._size = size

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(0, 255, (3, size, size), uint8)`."""
        return spaces.Box(0, 255, (3, self._size, self._size), np.uint8)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the crop to `out`."""
        robot.pyramid.crop(*robot.belief.pose, self.resolution, out)
