"""Explorer that completes the map, and plans tours over the expected floor."""

from pathlib import Path

import numpy as np

from lidarnaut.baselines.frontier.expected_tour import ExpectedTour
from lidarnaut.baselines.frontier.pursuit_explorer import PERIOD, PursuitDriving
from lidarnaut.envs.navigation import Markers

from .completion import Completion


class ForesightExplorer(PursuitDriving):
    """Explorer that chooses, each second, the first frontier of a short tour over the expected map.

    The map is completed near known floor by a network; it drives like `PursuitExplorer`.
    """

    rule: ExpectedTour

    def __init__(self, completion: Completion) -> None:
        super().__init__(ExpectedTour(completion), max_time=PERIOD)

    @property
    def markers(self) -> Markers | None:  # type: ignore[override]
        """Those of the frontiers, and the predicted floor and the tour of the last choice."""
        markers, expected = super().markers, self.rule.expected if self._has_begun else None
        if markers is None or expected is None or not len(markers.chosen):
            return markers
        cells = np.argwhere(expected.expected > 0.0)
        predicted = np.column_stack([expected.centers(cells), expected.expected[tuple(cells.T)]])
        chosen = np.abs(markers.clusters - markers.chosen).sum(axis=1).argmin() if len(markers.clusters) else -1
        tour = self.rule.tours.get(int(chosen), markers.tour)
        return markers._replace(predicted=predicted, side=expected.side, tour=tour)

    @classmethod
    def load(cls, folder: str | Path) -> "ForesightExplorer":
        """Load the network of an explorer from a folder; raise CheckpointError if unreadable."""
        return cls(Completion.load(folder))
