"""Worlds: a library of known places, endless procedural ones, and map files."""

from .world import Mover, World

__all__ = ["Mover", "World"]
