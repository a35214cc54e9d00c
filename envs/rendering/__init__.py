"""Pictures of episodes: the ground truth beside the robot's map and pose estimate."""

from .renderer import Renderer
from .scene import Scene

__all__ = ["Renderer", "Scene"]
