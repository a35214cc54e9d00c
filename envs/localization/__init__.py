"""Localisation on a known map."""

from .localizer import Localizer, PoseEstimate

__all__ = ["Localizer", "PoseEstimate"]
