"""Construction of policies from names or objects."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium import spaces

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.adoption import adopt
from lidarnaut.baselines.policy import Policy
from lidarnaut.envs.core import lidar_env_of


def make_policy(policy: Any, env: gymnasium.Env | spaces.Space | None = None, *, trust: Iterable[str] = ()) -> Policy:
    """Return a policy with a given name, or made from an object.

    Names are those of the command line, see `lidarnaut.agents.policy_names.parse_policy`: for example `pursuit`,
    `rrt?eta_local=0.5`, `pretrained/crowd`, `ppo:runs/RUN?deterministic=false` or `module:attribute`.

    Args:
        policy: name, `Path` of a folder, or an object as for `lidarnaut.baselines.adoption.adopt`.
        env: environment, which chooses among policies of the same name: `pursuit` explores, or drives to a goal. It is
            reset if it has no episode. An action space only clips actions. By default, explorers come first.
        trust: modules, or names `module:attribute`, of your own code that a learned policy may import.

    Returns:
        `Explorer` or `ObservationPolicy`. The environment must have the `observations` of a learned policy.

    Raises:
        ValueError: if the policy is unknown, unsuitable for the environment, or names code that is not trusted.
        lidarnaut.agents.run_folder.CheckpointError: if there is no such folder, it is damaged, or it does not support
            the parameters.
    """
    space = env.action_space if isinstance(env, gymnasium.Env) else env
    if not isinstance(policy, str | Path):
        return adopt(policy, space)
    name = f"ppo:{policy}" if isinstance(policy, Path) else policy
    if not isinstance(env, gymnasium.Env):
        return parse_policy(name, trust=trust).make(space)
    if not lidar_env_of(env).has_begun:
        env.reset()  # sets the attributes of the task
    return parse_policy(name, policies_for(env), trust=trust).make(space)


make_explorer = make_policy  # name of earlier versions
