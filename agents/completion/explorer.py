"""Explorer that completes the map, and plans its tours over what it expects."""

from pathlib import Path

from lidarnaut.baselines.frontier.expected_tour import ExpectedTour, TourOverExpected
from lidarnaut.baselines.frontier.pursuit_explorer import PERIOD, PursuitDriving

from .completion import Completion


class ForesightExplorer(PursuitDriving):
    """Explorer that chooses, each second, the frontier at which a short tour over the expected map begins.

    The map is completed near known floor by a network; it drives like `PursuitExplorer`.
    """

    rule: ExpectedTour

    def __init__(self, completion: Completion, params: TourOverExpected = TourOverExpected()) -> None:
        super().__init__(ExpectedTour(completion, params), max_time=PERIOD)

    @classmethod
    def load(cls, folder: str | Path) -> "ForesightExplorer":
        """Load the network of an explorer from a folder; raise CheckpointError if unreadable."""
        return cls(Completion.load(folder))
