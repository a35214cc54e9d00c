"""Trainings of less than a second."""

from lidarnaut.agents.algorithms import build_model, find_algorithm, prepare
from lidarnaut.agents.config import ALGORITHMS, parse_config

CHOOSING = ("PPO", "A2C", "MaskablePPO", "DQN", "QRDQN")
"""Algorithms for discrete actions."""
DISCRETE = ("DQN", "QRDQN", "MaskablePPO")
TWISTS = [name for name in ALGORITHMS if name not in DISCRETE]
CASES = [(name, "Explore" if k % 2 == 0 else "Navigate") for k, name in enumerate(TWISTS)]
CASES += [(name, "ExploreFrontiers") for name in CHOOSING]
"""Each algorithm for twists with an exploration or a goal, and each one for decisions."""
WITH_BUFFER = ("SAC", "TD3", "DDPG", "DQN", "TQC", "CrossQ", "QRDQN")


def tiny(algorithm, id, **changes):
    """Return a training of two updates of eight steps each, with a checkpoint after each."""
    environment = {"id": f"lidarnaut/{id}-v0", "num_workers": 0, "time_limit": 1.0}
    environment |= {"world": "rooms", "world_size": [6, 6]}
    if id == "Navigate":
        environment["localizer"] = "truth"
    hyperparameters = {"n_steps": 4} if algorithm == "A2C" else {"n_steps": 4, "batch_size": 8}
    if algorithm in WITH_BUFFER:
        hyperparameters = {"train_freq": 4, "gradient_steps": 2, "batch_size": 4, "learning_starts": 4}
        hyperparameters |= {"buffer_size": 12, "policy_kwargs": {"net_arch": [8, 8]}}
    if algorithm in ("TD3", "DDPG"):
        hyperparameters["action_noise"] = 0.1
    network = {"features": 8, "channels": 2, "hidden": 8}
    if "Frontiers" in id and algorithm in ("PPO", "A2C"):
        network = {"width": 8, "heads": 2}
    data = {"experiment": "tiny", "total_steps": 16, "num_envs": 2, "algorithm": algorithm, "network": network}
    data |= {"environment": environment, "hyperparameters": hyperparameters}
    data |= {"evaluation": {"episodes": 1, "every": 1000}, "checkpoints": {"every": 8, "keep": 2}}
    return parse_config(data | changes, "tiny")


def untrained(config, env):
    """Return an algorithm with an untrained policy."""
    return build_model(prepare(config, find_algorithm(config.algorithm), env), env)
