"""Localization on a known map."""

from .amcl import Amcl
from .amcl_params import PRESETS, AmclParams, load_preset

__all__ = ["PRESETS", "Amcl", "AmclParams", "load_preset"]
