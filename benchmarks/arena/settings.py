"""What an evaluation consists of."""

from dataclasses import dataclass
from typing import Any

import gymnasium

import envs  # noqa: F401  registers the environments


@dataclass(frozen=True, slots=True)
class Settings:
    """What an evaluation consists of."""

    policies: tuple[str, ...]
    """Explorers: classic ones by name, learned ones as `ppo:PATH`; a name of one's own goes before, as `LABEL=`."""
    worlds: tuple[str, ...]
    """Worlds, as the environment takes them; procedural families draw from their test split."""
    episodes: int = 10
    """Episodes of each policy in each world."""
    seed: int = 0
    """Episode i is seeded with `seed + i`, for every policy and world: same place, same start."""
    robot: str | None = None
    """Robot; None takes each world's usual one."""
    physics: str = "bullet"
    """`bullet` or `kinematic`."""
    slam: str = "tinyslam"
    """SLAM in the loop."""
    time_limit: float | None = None
    """Length of an episode [s]; None lets the environment choose it for the place."""

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("policies must name at least one explorer")
        if not self.worlds or len(set(self.worlds)) < len(self.worlds):
            raise ValueError(f"worlds must name at least one, and none twice, got {', '.join(self.worlds)}")
        if self.episodes < 1:
            raise ValueError(f"episodes must be at least 1, got {self.episodes}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")

    def make_env(self, world: str, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Make the environment for one of the worlds."""
        return gymnasium.make(
            "lidarnaut/Explore-v0",
            world=world,
            robot=self.robot,
            physics=self.physics,
            slam=self.slam,
            time_limit=self.time_limit,
            split="test",
            render_mode=render_mode,
            disable_env_checker=True,
        )
