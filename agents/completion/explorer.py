"""Explorer that completes the map, and plans tours over the expected floor."""

from pathlib import Path

from lidarnaut.baselines.frontier.expected_tour import ExpectedTour
from lidarnaut.baselines.frontier.pursuit_explorer import PERIOD, PursuitDriving

from .completion import Completion


class ForesightExplorer(PursuitDriving):
    """Explorer that chooses, each second, the first frontier of a short tour over the expected map.

    The map is completed near known floor by a network; it drives like `PursuitExplorer`.
    """

    rule: ExpectedTour

    def __init__(self, completion: Completion) -> None:
        super().__init__(ExpectedTour(completion), max_time=PERIOD)

    @classmethod
    def load(cls, folder: str | Path) -> "ForesightExplorer":
        """Load the network of an explorer from a folder; raise CheckpointError if unreadable."""
        return cls(Completion.load(folder))
