"""Pose graphs of submaps: nodes, submaps, constraints between them, and their optimisation."""

from .optimise import optimise, optimise_step
from .records import Constraints, Graph, PoseGraph
from .residuals import chi_squares, drop_outliers

__all__ = [
    "Constraints",
    "Graph",
    "PoseGraph",
    "chi_squares",
    "drop_outliers",
    "optimise",
    "optimise_step",
]
