"""Classic explorers and the path follower that they drive with."""

from .explorer import Explorer
from .frontier import FrontierExplorer, FrontierParams
from .nearest import NearestExplorer, NearestParams
from .random import RandomExplorer
from .rrt import RrtExplorer, RrtParams

EXPLORERS: dict[str, type[Explorer]] = {
    "random": RandomExplorer,
    "nearest": NearestExplorer,
    "frontier": FrontierExplorer,
    "rrt": RrtExplorer,
}
"""Explorers by name."""


def make_explorer(name: str) -> Explorer:
    """Return a new explorer with its default parameters.

    Raises:
        ValueError: the name is unknown.
    """
    if name not in EXPLORERS:
        raise ValueError(f"unknown explorer {name!r}; choose one of {', '.join(EXPLORERS)}")
    return EXPLORERS[name]()


__all__ = [
    "EXPLORERS",
    "Explorer",
    "FrontierExplorer",
    "FrontierParams",
    "NearestExplorer",
    "NearestParams",
    "RandomExplorer",
    "RrtExplorer",
    "RrtParams",
    "make_explorer",
]
