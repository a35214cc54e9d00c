"""Pictures of a robot that explores: the truth beside what it believes."""

from .renderer import Renderer
from .scene import Scene

__all__ = ["Renderer", "Scene"]
