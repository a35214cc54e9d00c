"""Policy for PPO and A2C that selects one of 66 or 130 candidate twists."""

import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import CategoricalDistribution
from torch import Tensor, nn
from torch.nn import functional

from lidarnaut.agents.networks import JointPolicy, Tensors
from lidarnaut.envs.observations.positions import GOAL_RANGE, NEAR_RANGE
from lidarnaut.envs.observations.scan import SPEED_RANGE
from lidarnaut.envs.observations.trajectories import END, FINE_TWISTS, NUMBERS, TURN, TWISTS
from lidarnaut.envs.tasks.carrot import AHEAD

NEEDED = "trajectories", "motion", "limits"
FAR = 10.0
"""Distance assumed for goals without an observed distance, and for those beyond the `carrot` [m]."""
TABLES = {len(table): table for table in (TWISTS, FINE_TWISTS)}
"""Candidate twists by number of rows of the observation `trajectories`."""
AT_GOAL = 0.01
"""Distance to a goal with a heading below which the robot should have this heading, not that towards the goal [m]."""
GOAL_SCALES = {4: NEAR_RANGE, 5: GOAL_RANGE}
"""Distance that is 1 in the observation `goal` [m], by the number of its values. Observations with other numbers begin
with a direction, and have no such distance."""
ON_PATH = slice(2, 4)
"""Indices of the direction to the point 0.6 m ahead on the path to the best frontier, in the observation `plan`."""
LAST_ACTION = slice(2, 4)
OWN_NUMBERS = 6
"""Number of additional features per twist, such as the decrease of the distance to the goal."""
PRIOR = {0: 0.5, 7: 1.0, NUMBERS: 1.0, NUMBERS + 1: 0.5}
"""Initial weights of features of a twist in its logit, relative to `prior`: time to contact with a wall, minimum gap,
progress, and final heading; as in the dynamic window approach (Fox, Burgard and Thrun, 1997)."""
INITIAL_GAIN = 0.05
"""Gain of the orthogonal initialization of the last layer; small for nearly uniform probabilities."""


class TwistChoice(CategoricalDistribution):
    """Categorical distribution over candidate twists (forward speed, yaw rate); samples are twists."""

    def __init__(self, twists: Tensor) -> None:
        super().__init__(len(twists))
        self._twists = twists

    def proba_distribution(self, action_logits: Tensor) -> "TwistChoice":
        self.logits = action_logits
        return super().proba_distribution(action_logits)

    def log_prob(self, actions: Tensor) -> Tensor:
        return super().log_prob(torch.cdist(actions, self._twists).argmin(dim=1))

    def sample(self) -> Tensor:
        return self._twists[super().sample()]

    def mode(self) -> Tensor:
        return self._twists[self.logits.argmax(dim=1)]


class TrajectoryNetwork(nn.Module):
    """Network that rates candidate velocity commands (twists) by logits, and estimates the state value.

    A shared MLP computes the logit of a twist from all observations and features of the twist: predicted effects,
    decrease of the goal distance, alignment of the final heading with the goal direction (within `AT_GOAL` of a goal
    with a heading: with that), and change from the last action. The value uses mean and maximum over twists.
    """

    twists: Tensor

    def __init__(self, observation_space: spaces.Dict, *, width: int, hidden: int, prior: float = 0.0) -> None:
        """Build the layers; raise ValueError if a required observation is missing.

        `width`: number of learned features per twist. `hidden`: width of the value layers. `prior`: initial weight of
        progress towards the goal in the logits; weights of further features are relative to it (`PRIOR`).
        """
        super().__init__()
        names = set(observation_space.spaces)
        if not {*NEEDED} <= names or not names & {"goal", "carrot", "plan"}:
            raise ValueError(
                f"the trajectory network requires {list(NEEDED)} and `goal`, `carrot` or `plan`, but the "
                f"observation space has {sorted(names)}"
            )
        if (rows := len(observation_space["trajectories"].low)) not in TABLES:  # type: ignore[attr-defined]
            raise ValueError(f"the trajectory network rates {' or '.join(map(str, TABLES))} twists, not {rows}")
        self.register_buffer("twists", torch.from_numpy(TABLES[rows]))
        self._others = sorted(names - {"trajectories"})
        self._goal_scale = GOAL_SCALES.get(spaces.flatdim(observation_space["goal"])) if "goal" in names else None
        self._has_heading = self._goal_scale == GOAL_RANGE
        others = sum(spaces.flatdim(observation_space[name]) for name in self._others)
        self.embed = nn.Linear(NUMBERS + OWN_NUMBERS + others, width)
        self.rate = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1, bias=False))
        self.add = nn.Linear(NUMBERS + OWN_NUMBERS, 1, bias=False)
        self.look = nn.Linear(NUMBERS + OWN_NUMBERS, width)
        self.judge = nn.Sequential(
            nn.Linear(2 * width + others, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1)
        )
        nn.init.orthogonal_(self.rate[-1].weight, INITIAL_GAIN)  # type: ignore[arg-type]
        nn.init.zeros_(self.add.weight)
        with torch.no_grad():
            self.add.weight[0, [*PRIOR]] = prior * torch.tensor([*PRIOR.values()])

    def forward(self, observations: Tensors) -> tuple[Tensor, Tensor]:
        """Return logits of twists, shape (batch, n), and state values, shape (batch, 1), float32."""
        shown, goal = observations["trajectories"], self._goal(observations)[:, None]
        rest = goal - shown[:, :, END]
        nearer = goal.norm(dim=2) - rest.norm(dim=2)
        turn = torch.pi * shown[:, :, TURN]
        facing = (turn.cos() * goal[:, :, 0] + turn.sin() * goal[:, :, 1]) / goal.norm(dim=2).clamp(min=1e-6)
        if self._has_heading:
            ahead = observations["goal"][:, 3:4] * turn.cos() + observations["goal"][:, 4:5] * turn.sin()
            aligned = 1.0 - (2.0 - 2.0 * ahead).clamp(min=0.0).sqrt()
            away = SPEED_RANGE * observations["limits"][:, :1] * goal.norm(dim=2)
            facing = torch.where(away < AT_GOAL, aligned, facing)
        change = (self.twists - observations["motion"][:, None, LAST_ACTION]).abs()
        own = self.twists.expand(shown.shape[0], -1, -1)
        effects = torch.stack([nearer, facing], dim=2)
        twists = torch.cat([shown, effects, change, own[:, :, :1], own[:, :, 1:].abs()], dim=2)
        others = torch.cat([observations[name].flatten(1) for name in self._others], dim=1)
        # Split layer: features common to all twists are multiplied once.
        weight, shared = self.embed.weight.split([twists.shape[2], others.shape[1]], dim=1)
        rows = functional.linear(twists, weight) + functional.linear(others, shared, self.embed.bias)[:, None]
        logits = (self.rate(rows) + self.add(twists)).squeeze(2)
        seen = functional.relu(self.look(twists))
        return logits, self.judge(torch.cat([seen.mean(dim=1), seen.amax(dim=1), others], dim=1))

    def _goal(self, observations: Tensors) -> Tensor:
        if "carrot" in observations:
            carrot = observations["carrot"]
            goal = torch.where(carrot[:, 2:] < 1.0, AHEAD * carrot[:, 2:], FAR) * carrot[:, :2]
        elif "plan" in observations:
            goal = FAR * observations["plan"][:, ON_PATH]
        elif self._goal_scale is None:
            goal = FAR * observations["goal"][:, :2]
        else:
            goal = self._goal_scale * observations["goal"][:, :1] * observations["goal"][:, 1:3]
        return goal / (SPEED_RANGE * observations["limits"][:, :1])


class TrajectoryPolicy(JointPolicy):
    """Actor-critic policy that samples one of the velocity commands, with probabilities from a `TrajectoryNetwork`."""

    kind = TrajectoryNetwork

    def judge(self, obs: Tensors) -> tuple[TwistChoice, Tensor]:
        logits, values = self.network(obs)
        return TwistChoice(self.network.twists).proba_distribution(logits), values
