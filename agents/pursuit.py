"""The policy of PPO that drives, with a first guess by the plan that it sees."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import DiagGaussianDistribution
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from lidarnaut.agents.networks import JointPolicy, Tensors
from lidarnaut.baselines.frontier.pursuit import TURN
from lidarnaut.envs.observations.plan import WIDTH

BACK = -0.3
"""Forward speed of the guess in contact, as a fraction of the robot's limit."""
SPIN = 0.4
"""Yaw rate of the guess where there is no plan, as a fraction of the robot's limit: to look around."""
BUMPER, PRESENT = 4, WIDTH - 1
"""Index in `motion` of the bumper, and in `plan` of whether there is a path."""


def pursue(plan: Tensor, motion: Tensor) -> Tensor:
    """Return the twist that turns towards the nearest point shown of the best path, and drives where that lies ahead.

    Forward speed is the cosine of the direction, and 0 where that is negative. In contact the robot backs up. Takes the
    parts `plan`, shape (batch, n), and `motion`, (batch, 6), of observations; returns forward speed and yaw rate over
    the robot's limits, shape (batch, 2), float32.
    """
    cosine, sine, present, bumper = plan[:, 0], plan[:, 1], plan[:, PRESENT], motion[:, BUMPER]
    turn = (TURN * torch.atan2(sine, cosine)).clamp(-1.0, 1.0)
    speed = (1.0 - bumper) * cosine.clamp_min(0.0) + bumper * BACK
    return torch.stack([speed, present * turn + (1.0 - present) * SPIN], dim=1)


class UntrainedPursuit:
    """The mean action of a `PursuitPolicy` before its training; a policy of twists, without a network."""

    level = "twist"
    observations = ("motion", "plan")

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Return the action for an observation, shape (2,), float32."""
        return pursue(*(torch.from_numpy(observation[name])[None] for name in ("plan", "motion")))[0].numpy()


class PursuitPolicy(JointPolicy):
    """A Gaussian policy; its mean is `weight * pursue(...)` plus what the network says, which is nearly 0 at first."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        weight: float = 1.0,
        **arguments: Any,
    ) -> None:
        """Build the network; `arguments` are those of the base class; ValueError if the observation has no `plan`."""
        if "plan" not in observation_space.spaces:
            raise ValueError(
                "network.pursuit needs the observation `plan`; name it in environment.observations, or set it to 0"
            )
        self._weight = weight
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def judge(self, obs: Tensors) -> tuple[DiagGaussianDistribution, Tensor]:
        assert isinstance(self.action_dist, DiagGaussianDistribution)
        latent_pi, latent_vf = self.mlp_extractor(self.extract_features(obs))
        mean = self.action_net(latent_pi) + self._weight * pursue(obs["plan"], obs["motion"])
        return self.action_dist.proba_distribution(mean, self.log_std), self.value_net(latent_vf)
