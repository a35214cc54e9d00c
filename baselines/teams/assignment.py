"""Rules that say which robot of a team goes to which frontier."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from baselines.frontier.explorer import FrontierRule
from envs.estimation import Belief
from envs.navigation import Candidates, GainOverCost
from envs.navigation.team_navigator import OVERLAP, UNASSIGNED, discount


class Assignment(Protocol):
    """Says which robot goes where."""

    def __call__(self, offers: Sequence[Candidates], taken: np.ndarray, beliefs: Sequence[Belief]) -> Sequence[int]:
        """Return the index of each robot's candidate; `UNASSIGNED` for robots without any.

        `offers` are the candidates of the robots that are assigned one now, `taken` the frontiers that further robots
        drive to, shape (k, 2), map frame [m]; `beliefs` are those of the robots that offer.
        """


class Auction:
    """Sells frontiers one after the other, each to the robot that bids most for any of those left.

    Sequential single-item auctions: Zlot, Stentz, Dias, Thayer, "Multi-robot exploration controlled by a market
    economy" (2002); Koenig et al., "The power of sequential single-item auctions for agent coordination" (2006). A bid
    is what a rule says; unknown area near frontiers that others go to counts less (`discount`).
    """

    def __init__(self, rule: FrontierRule | None = None, overlap: float = OVERLAP) -> None:
        """Take a rule, `GainOverCost` by default, and the distance up to which robots see the same [m]."""
        self._rule, self._overlap = rule or GainOverCost(), overlap

    def __call__(self, offers: Sequence[Candidates], taken: np.ndarray, beliefs: Sequence[Belief]) -> list[int]:
        """Return each robot's candidate; see `Assignment`."""
        offers = [replace(candidates, table=candidates.table.copy()) for candidates in offers]
        chosen = [UNASSIGNED] * len(offers)
        left = [k for k, candidates in enumerate(offers) if len(candidates)]
        for frontier in taken:
            self._discount(offers, frontier)
        while left:
            bids = {k: np.asarray(self._rule(offers[k], beliefs[k])) for k in left}
            winner = max(left, key=lambda k: float(bids[k].max()))
            chosen[winner] = int(bids[winner].argmax())
            left.remove(winner)
            self._discount(offers, offers[winner]["frontier"][chosen[winner]])
        return chosen

    def _discount(self, offers: Sequence[Candidates], frontier: np.ndarray) -> None:
        for candidates in offers:
            discount(candidates, frontier, self._overlap)
