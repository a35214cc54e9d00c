"""GMapping: a Rao-Blackwellised particle filter whose particles hold maps."""

from .gmapping import GMapping
from .params import GMAPPING_PRESETS, GMappingParams, load_gmapping_params

__all__ = ["GMAPPING_PRESETS", "GMapping", "GMappingParams", "load_gmapping_params"]
