"""Pose graph of scans and submaps, with its optimisation."""

from .graph import Constraints, Graph, PoseGraph, PoseGraphView
from .optimise import chi_squares, drop_outliers, optimise_step

__all__ = ["Constraints", "Graph", "PoseGraph", "PoseGraphView", "chi_squares", "drop_outliers", "optimise_step"]
