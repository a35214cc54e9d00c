"""Gaussian policy that adds a learned correction to path following."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import DiagGaussianDistribution
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from lidarnaut.agents.networks import JointPolicy, Tensors
from lidarnaut.baselines.frontier.pursuit_explorer import TURN
from lidarnaut.envs.observations.plan import WIDTH

BACK = -0.3
"""Forward speed after contact, divided by the robot's maximum; negative to back up."""
SPIN = 0.4
"""Yaw rate without a path, divided by the robot's maximum."""
BUMPER, PRESENT = 4, WIDTH - 1
"""Index of the contact flag in the observation `motion`, and of the flag in `plan` that a path exists."""


def pursue(plan: Tensor, motion: Tensor) -> Tensor:
    """Return the twist towards the point 0.3 m ahead on the path to the best frontier.

    Forward speed is the cosine of the bearing, at least 0. After contact, the robot backs up. Without a path, the robot
    turns in place.

    Args:
        plan: observation `plan`, shape (batch, n), float32.
        motion: observation `motion`, shape (batch, 6), float32.

    Returns:
        Forward speed and yaw rate, divided by the robot's limits, shape (batch, 2), float32.
    """
    cosine, sine, present, bumper = plan[:, 0], plan[:, 1], plan[:, PRESENT], motion[:, BUMPER]
    turn = (TURN * torch.atan2(sine, cosine)).clamp(-1.0, 1.0)
    speed = (1.0 - bumper) * cosine.clamp_min(0.0) + bumper * BACK
    return torch.stack([speed, present * turn + (1.0 - present) * SPIN], dim=1)


class PlanPursuit:
    """Non-learned policy that follows the path to the best frontier in the observation `plan`."""

    level = "twist"
    observations = ("motion", "plan")

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return pursue(*(torch.from_numpy(observation[name])[None] for name in ("plan", "motion")))[0].numpy()


class PlanPriorPolicy(JointPolicy):
    """Gaussian policy with mean = `weight` x path-following command + network output.

    The network output is initially near 0.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        weight: float = 1.0,
        **arguments: Any,
    ) -> None:
        if "plan" not in observation_space.spaces:
            raise ValueError(
                "network.plan_prior needs the observation `plan`; add it to environment.observations, or set 0"
            )
        self._weight = weight
        super().__init__(observation_space, action_space, lr_schedule, **arguments)

    def judge(self, obs: Tensors) -> tuple[DiagGaussianDistribution, Tensor]:
        assert isinstance(self.action_dist, DiagGaussianDistribution)
        latent_pi, latent_vf = self.mlp_extractor(self.extract_features(obs))
        mean = self.action_net(latent_pi) + self._weight * pursue(obs["plan"], obs["motion"])
        return self.action_dist.proba_distribution(mean, self.log_std), self.value_net(latent_vf)
