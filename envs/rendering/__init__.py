"""Pictures of episodes: ground truth, and the robot's map and pose estimate."""

from .renderer import Renderer
from .scene import Scene

__all__ = ["Renderer", "Scene"]
