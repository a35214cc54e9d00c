"""One control period of one robot or many: physics, sensors, odometry and predicted poses, by kernels over rows."""

from .transition import Transition

__all__ = ["Transition"]
