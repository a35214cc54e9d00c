"""Additions of a policy to pictures of an episode."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lidarnaut.envs.navigation import Markers
from lidarnaut.envs.navigation.controllers.local_planner import NO_TRACKS

from .scene import Scene


class Overlay:
    """Plans, tracks and markers of a policy, set by its user and cleared by `LidarEnv.reset`; and the renderer."""

    def __init__(self, num_robots: int) -> None:
        self.plans: list[np.ndarray | None] = [None] * num_robots
        """Planned path of each robot, shape (n, 2), map frame [m], or None."""
        self.tracks = NO_TRACKS
        """People tracked by the first robot, shape (n, 5): x, y, vx, vy, radius, map frame [m, m/s]."""
        self.markers: Callable[[], Markers | None] | None = None
        """Function that returns the markers of the policy."""
        self._renderer: Any = None

    @property
    def plan(self) -> np.ndarray | None:
        """Planned path of the first robot."""
        return self.plans[0]

    @plan.setter
    def plan(self, path: np.ndarray | None) -> None:
        self.plans[0] = path

    def clear(self) -> None:
        self.plans, self.tracks, self.markers = [None] * len(self.plans), NO_TRACKS, None

    def draw(self, scene: Scene, mode: str, fps: float) -> np.ndarray | None:
        """Draw a scene; return an image, shape (height, width, 3), uint8, or None for the mode "human"."""
        if self._renderer is None:
            from .renderer import Renderer

            self._renderer = Renderer(mode, fps)
        image: np.ndarray | None = self._renderer.draw(scene)
        return image

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}
