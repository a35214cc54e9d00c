"""Attention network that rates frontier candidates, and a policy for PPO and A2C."""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import CategoricalDistribution
from torch import Tensor, nn
from torch.nn import functional

from lidarnaut.agents.networks import PATCH, JointPolicy, MapPatches, Tensors
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.frontiers.candidates import COST, FAILURES, HALF_AREA, HALF_COST, VISIBLE

from .features import NUM_FEATURES
from .score import FAILURE_PENALTY, FrontierScore

MASKED = -1e9
"""Logit of invalid actions, which have probability 0."""
MAP_CHANNELS = 8
MAX_INITIAL_SLOPE = 6.0
"""Initial distance penalty of the last attention head; that of the first head is 0. The attention logit of two
frontiers decreases by penalty x normalized distance."""
RULE = "rule"
"""Value of `prior_policy` for the rule `gain_over_cost` (unknown area / path cost)."""
NEEDED = ("candidates", "sectors", "gaps", "action_mask", "map", "robot")


def _length(share: Tensor, half: float) -> Tensor:
    return half * share.clamp_min(0.0) / (1.0 - share).clamp_min(1e-6)


class FrontierNetwork(nn.Module):
    """Attention network that rates frontier candidates by logits, and estimates the state value.

    The logit of a frontier is `prior` x utility + correction. The utility is a linear frontier score, or that of the
    rule `gain_over_cost`: log(visible unknown area + 0.3) - log(path cost + 3). The correction is learned, initially 0:
    self-attention among frontiers, decreasing with distance, then a shared MLP.
    """

    score: Tensor | None
    """Weights of the linear frontier score used as prior, shape (NUM_FEATURES,), float64; None for the rule
    `gain_over_cost`."""

    def __init__(
        self, observation_space: spaces.Dict, *, width: int, heads: int, prior: float, prior_policy: str = RULE
    ) -> None:
        """Build the layers; raise ValueError if a required observation is missing.

        `prior`: weight of the prior frontier score in the logits. `prior_policy`: `rule`, or another name for a linear
        score, whose weights are loaded later.
        """
        super().__init__()
        if missing := [key for key in NEEDED if key not in observation_space.spaces]:
            raise ValueError(
                f"the frontier network requires the observations {list(NEEDED)}, but the observation space "
                f"lacks {missing}; it has {sorted(observation_space.spaces)}"
            )
        shapes = {key: tuple(observation_space[key].shape or ()) for key in NEEDED}
        self._heads, self._prior, self._rule = heads, prior, GainOverCost()
        # Saved with the weights, so that checkpoints are self-contained.
        self.register_buffer("score", None if prior_policy == RULE else torch.zeros(NUM_FEATURES, dtype=torch.float64))
        self.map = MapPatches(shapes["map"], MAP_CHANNELS)
        num_patches = (shapes["map"][1] // PATCH) * (shapes["map"][2] // PATCH)
        self.context = nn.Linear(MAP_CHANNELS * num_patches + shapes["robot"][0], width)
        self.embed = nn.Linear(shapes["candidates"][1] + shapes["sectors"][1] + 3, width)
        self.attention = nn.Linear(width, 3 * width)
        self.slopes = nn.Parameter(torch.linspace(0.0, MAX_INITIAL_SLOPE, heads))
        self.norm = nn.LayerNorm(width)
        self.correct = nn.Sequential(
            nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1, bias=False)
        )
        self.judge = nn.Sequential(nn.Linear(3 * width, width), nn.ReLU(), nn.Linear(width, 1))
        nn.init.zeros_(self.correct[-1].weight)  # type: ignore[arg-type]

    def forward(self, observations: Tensors) -> tuple[Tensor, Tensor]:
        """Return logits, shape (batch, max_candidates), and state values, shape (batch, 1), float32."""
        slots = _Slots(observations["action_mask"] > 0)
        candidates = slots.take(observations["candidates"])
        utility, known = self._rate(observations, candidates, slots)
        seen = torch.cat([self.map(observations["map"].float()), observations["robot"]], dim=1)
        context = functional.relu(self.context(seen))
        rows = torch.cat([candidates, slots.take(observations["sectors"]), known], dim=1)
        rows = functional.relu(self.embed(rows) + context[slots.sample])
        rows = self.norm(rows + self._attend(rows, observations["gaps"], slots))
        logits = utility + self.correct(rows).squeeze(1)
        empty = ~slots.mask.any(dim=1, keepdim=True)
        mean = slots.table(rows, 0.0).sum(dim=1) / slots.mask.sum(dim=1, keepdim=True).clamp_min(1)
        greatest = slots.table(rows, MASKED).amax(dim=1).masked_fill(empty, 0.0)
        padding = observations["action_mask"].shape[1] - slots.count
        return (
            functional.pad(slots.table(logits, MASKED), (0, padding), value=MASKED),
            self.judge(torch.cat([context, mean, greatest], dim=1)),
        )

    def _rate(self, observations: Tensors, candidates: Tensor, slots: "_Slots") -> tuple[Tensor, Tensor]:
        gain = torch.log(_length(candidates[:, VISIBLE], HALF_AREA) + self._rule.least_gain)
        cost = torch.log(_length(candidates[:, COST], HALF_COST) + self._rule.least_cost)
        utility = gain - cost if self.score is None else self._weigh(observations, self.score)
        best = slots.table(utility, MASKED).amax(dim=1)
        logits = self._prior * utility - FAILURE_PENALTY * (candidates[:, FAILURES] > 0)
        return logits, torch.stack([gain, cost, utility - best[slots.sample]], dim=1)

    @staticmethod
    def _weigh(observations: Tensors, score: Tensor) -> Tensor:
        if torch.jit.is_tracing():
            raise ValueError("its prior is a frontier score, which is not computed by torch")
        names = ("candidates", "sectors", "gaps", "robot", "action_mask")
        samples = zip(*(observations[name].cpu().numpy() for name in names), strict=True)
        scorer = FrontierScore(score.cpu().numpy())
        features = [scorer.rate(dict(zip(names, sample, strict=True)))[0] for sample in samples]
        return torch.from_numpy(np.concatenate(features) @ scorer.weights).float().to(score.device)

    def _attend(self, rows: Tensor, gaps: Tensor, slots: "_Slots") -> Tensor:
        table = slots.table(self.attention(rows), 0.0)
        batch, count, width = *table.shape[:2], rows.shape[1]
        # Scale query and bias instead of the attention scores, which are larger.
        query, key, value = table.view(batch, count, 3, self._heads, -1).permute(2, 0, 3, 1, 4).flatten(1, 2)
        query = query * (self._heads / width) ** 0.5
        empty = (MASKED * ~slots.mask)[:, None, None, :]
        bias = torch.addcmul(empty, self.slopes[:, None, None], gaps[:, None, :count, :count], value=-1.0)
        shares = torch.baddbmm(bias.flatten(0, 1), query, key.transpose(1, 2)).softmax(dim=2)
        attended = (shares @ value).view(batch, self._heads, count, -1).transpose(1, 2).flatten(2)
        return attended[slots.sample, slots.slot]


class _Slots:
    def __init__(self, mask: Tensor) -> None:
        self.sample, self.slot = mask.nonzero(as_tuple=True)
        self.count = int(self.slot.max()) + 1 if len(self.slot) else 1
        self.mask = mask[:, : self.count]

    def take(self, table: Tensor) -> Tensor:
        return table[self.sample, self.slot]

    def table(self, rows: Tensor, fill: float) -> Tensor:
        return rows.new_full((*self.mask.shape, *rows.shape[1:]), fill).index_put((self.sample, self.slot), rows)


class FrontierPolicy(JointPolicy):
    """Actor-critic policy that samples a frontier candidate, with probabilities from a `FrontierNetwork`."""

    kind = FrontierNetwork

    def load_prior(self, score: FrontierScore) -> None:
        """Set the weights of the linear frontier score that is the prior policy."""
        self.network.score.copy_(torch.from_numpy(score.weights))

    def judge(self, obs: Tensors) -> tuple[CategoricalDistribution, Tensor]:
        assert isinstance(self.action_dist, CategoricalDistribution)
        logits, values = self.network(obs)
        return self.action_dist.proba_distribution(action_logits=logits), values
