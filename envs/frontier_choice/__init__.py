"""Frontiers to choose from, and a pilot that drives to the one that was chosen."""

from .choice import OUTCOMES, OVER, RESET, FrontierChoice
from .features import FEATURES
from .params import PilotParams, SurveyParams
from .pilot import act, judge, sense
from .records import DRIVING

__all__ = [
    "DRIVING",
    "FEATURES",
    "OUTCOMES",
    "OVER",
    "RESET",
    "FrontierChoice",
    "PilotParams",
    "SurveyParams",
    "act",
    "judge",
    "sense",
]
