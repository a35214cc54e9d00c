"""Simulation of pedestrian crowds."""

from .crowd_params import CROWDS, Crowd, crowd_of
from .people import People

__all__ = ["CROWDS", "Crowd", "People", "crowd_of"]
