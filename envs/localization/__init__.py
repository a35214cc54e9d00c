"""Localization on a known map."""

from .amcl import Amcl
from .localizer import Localizer, PoseEstimate
from .params import PRESETS, AmclParams, load_preset

__all__ = ["PRESETS", "Amcl", "AmclParams", "Localizer", "PoseEstimate", "load_preset"]
