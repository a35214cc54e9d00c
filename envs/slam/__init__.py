"""Simultaneous localisation and mapping."""

from .slam import Belief, Slam

__all__ = ["Belief", "Slam"]
