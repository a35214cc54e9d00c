"""The policy of PPO that chooses candidates."""

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import CategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from .network import FrontierNetwork
from .score import FrontierScore

Observations = dict[str, Tensor]
RULE = "rule"
"""As `prior_policy`: the rule `gain_over_cost`."""


class FrontierPolicy(ActorCriticPolicy):
    """Draws candidates by the logits of a `FrontierNetwork`, which also gives the values."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        *,
        width: int = 64,
        heads: int = 4,
        prior: float = 10.0,
        prior_policy: str = RULE,
        **arguments: Any,
    ) -> None:
        """Build the network; see there for `width`, `heads` and `prior`. `arguments` are those of the base class.

        With a `prior_policy` other than the rule, the network waits for the weights of that score; see `load_prior`.
        """
        self._sizes = {"width": width, "heads": heads, "prior": prior, "has_score": prior_policy != RULE}
        # The extractor has no weights; it is what the base class asks for.
        arguments["features_extractor_class"] = FlattenExtractor
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def load_prior(self, score: FrontierScore) -> None:
        """Start from a score of frontiers, where the policy was made with a `prior_policy`."""
        assert self.network.score is not None
        self.network.score.copy_(torch.from_numpy(score.weights))

    def forward(self, obs: Observations, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:  # type: ignore[override]
        """Return actions, values and the logarithms of the actions' probabilities."""
        logits, values = self.network(obs)
        distribution = self._distribution(logits)
        actions = distribution.get_actions(deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(self, obs: Observations, actions: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:  # type: ignore[override]
        """Return values, logarithms of the probabilities of given actions, and entropies."""
        logits, values = self.network(obs)
        distribution = self._distribution(logits)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations) -> CategoricalDistribution:  # type: ignore[override]
        """Return the distribution over the candidates."""
        return self._distribution(self.network(obs)[0])

    def predict_values(self, obs: Observations) -> Tensor:  # type: ignore[override]
        """Return the values, shape (batch, 1)."""
        return self.network(obs)[1]

    def _build(self, lr_schedule: Schedule) -> None:
        assert isinstance(self.observation_space, spaces.Dict)
        self.network = FrontierNetwork(self.observation_space, **self._sizes)  # type: ignore[arg-type]
        make: Any = self.optimizer_class
        self.optimizer = make(self.network.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def _distribution(self, logits: Tensor) -> CategoricalDistribution:
        assert isinstance(self.action_dist, CategoricalDistribution)
        return self.action_dist.proba_distribution(action_logits=logits)
