"""Goals in the form of Gymnasium-Robotics, for hindsight experience replay."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.tasks.goals import GoalTask


class GoalEnv(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Goal task in the form of Gymnasium-Robotics' `GoalEnv`, for hindsight experience replay (HER).

    Observations are `achieved_goal`, the estimated position (x, y), `desired_goal`, the goal (x, y), both in the map
    frame [m], and `observation`: all parts except `goal`, and cosine and sine of the estimated heading, in a vector.
    The reward is 0 within `goal_tolerance` of the goal, and otherwise -1, as in Plappert et al., "Multi-Goal
    Reinforcement Learning: Challenging Robotics Environments and Request for Research" (2018). `info` and ends are
    those of the task, which knows the true position.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Wrap an environment such as `ReachGoal-v0` with `contact="costs"`, or `Navigate-v0`.

        Raises:
            ValueError: if the task has no goal with a known position, ends at contacts, or parts show its goal.
        """
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._inner = inner = lidar_env_of(env)
        task = inner.task
        if not isinstance(task, GoalTask) or getattr(task, "goal_given", "pose") != "pose":
            raise ValueError(f"GoalEnv needs a task whose goal is a known position, got {type(task).__name__}")
        if getattr(task, "contact", "costs") == "ends":
            raise ValueError("GoalEnv needs contact='costs': at -1 per step, contacts that end the episode would pay")
        if shown := [name for name in ("carrot", "trajectories") if name in inner.parts]:
            raise ValueError(f"GoalEnv needs observations that do not depend on the goal, got {shown}")
        self._parts = {name: space for name, space in inner.observation_space.spaces.items() if name != "goal"}
        boxes: list[Any] = [*map(spaces.flatten_space, self._parts.values()), spaces.Box(-1.0, 1.0, (2,))]
        low, high = (np.concatenate(ends, dtype=np.float32) for ends in zip(*((box.low, box.high) for box in boxes)))
        position = spaces.Box(-np.inf, np.inf, (2,))
        self.observation_space = spaces.Dict(
            {"observation": spaces.Box(low, high), "achieved_goal": position, "desired_goal": position}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; ValueError if the goal has a heading, which positions cannot show."""
        observation, info = self.env.reset(seed=seed, options=options)
        if self._inner.task.heading_tolerance < np.pi:
            raise ValueError("GoalEnv needs goals (x, y), without a heading or heading_tolerance")
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = self.env.step(action)
        seen = self._observe(observation)
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        return seen, float(reward), terminated, truncated, info

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        """Return rewards of positions and goals, both of shape (..., 2) [m]: float32, shape (...). `info` is unused."""
        away = np.linalg.norm(np.asarray(achieved_goal) - desired_goal, axis=-1)
        return (away <= self._inner.task.goal_tolerance).astype(np.float32) - np.float32(1.0)

    def _observe(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        (x, y, theta), goal = self._inner.belief.pose, self._inner.task.goal[:2]
        parts: list[Any] = [spaces.flatten(space, observation[name]) for name, space in self._parts.items()]
        whole = np.concatenate([*parts, [np.cos(theta), np.sin(theta)]], dtype=np.float32)
        achieved, desired = np.array([[x, y], goal], dtype=np.float32)
        return {"observation": whole, "achieved_goal": achieved, "desired_goal": desired}
