"""Rules over frontiers as policies of a decision-level environment, to compare learned ones with."""

from typing import Any

import gymnasium
import numpy as np

from agents.policies import level_of, make_policy
from baselines import EXPLORERS
from baselines.explorer import ObservationPolicy
from baselines.frontier.explorer import FrontierRule, RuleExplorer
from baselines.random import RandomExplorer
from envs.estimation import Belief
from envs.files import resolve
from envs.navigation import Candidates
from envs.robots import RobotParams


class RandomRule:
    """Draws any candidate: the lowest reference."""

    def reset(self, robot: RobotParams, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, candidates: Candidates, belief: Belief) -> int:
        return int(self._rng.integers(len(candidates)))


class RulePolicy:
    """Chooses in an environment as a rule says."""

    level = "decision"
    end_reason = plan = None
    """The environment ends the episode, and plans."""

    def __init__(self, rule: FrontierRule, env: gymnasium.Env[Any, Any]) -> None:
        """Take a rule, and the environment, an `ExploreFrontiersEnv`, whose candidates it chooses from."""
        self._rule, self._env = rule, env.unwrapped

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        if hasattr(self._rule, "reset"):
            self._rule.reset(robot, rng)

    def __call__(self, observation: dict[str, np.ndarray]) -> np.int64:
        """Return the candidate to go to."""
        env: Any = self._env
        return np.int64(self._rule(env.candidates, env.belief) if len(env.candidates) else 0)


def make_reference(name: str, env: gymnasium.Env[Any, Any]) -> ObservationPolicy:
    """Return what chooses frontiers in an environment, by the name of an explorer or as `module:attribute`.

    Of explorers that drive by a rule, the rule is taken; `random` draws any candidate.

    Raises:
        ValueError: if it is no rule, and no policy of decisions.
    """
    source = resolve(name, EXPLORERS, "explorer")
    if source is RandomExplorer:
        return RulePolicy(RandomRule(), env)
    policy: Any = make_policy(source, env.action_space)
    if isinstance(policy, RuleExplorer):
        return RulePolicy(policy.rule, env)
    if "decision" in (level_of(source), level_of(policy)):
        return policy
    rules = [key for key, make in EXPLORERS.items() if isinstance(make(), RuleExplorer)]
    raise ValueError(
        f"{name!r} drives by twists, and cannot choose frontiers; allowed are random, {', '.join(rules)}, and "
        "module:attribute of a rule or of a policy of decisions"
    )
