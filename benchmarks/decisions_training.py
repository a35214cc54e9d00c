"""How many decisions per second PPO learns from, all included: `python -m benchmarks.decisions_training`.

Updates of a training by a configuration, in one process with one thread of torch. What counts is processor time, since
the wall clock of a shared machine also measures other processes. Evaluations are left out.
"""

import time
from pathlib import Path

from rich.table import Table
from stable_baselines3.common.logger import Logger

from agents.algorithms import build_model, rollout_steps
from agents.config import TrainingConfig
from agents.vec_env import GymnasiumVecEnv, make_vector
from envs.command_line import Count, make_console, run_command
from envs.files import read_record


class _TimedVecEnv(GymnasiumVecEnv):
    """Keeps the processor time that its steps take."""

    seconds = 0.0

    def step_wait(self):
        began = time.process_time()
        stepped = super().step_wait()
        self.seconds += time.process_time() - began
        return stepped


def measure(config: TrainingConfig, updates: int) -> tuple[int, float, float]:
    """Train for one update, and measure the next ones.

    Args:
        config: the training.
        updates: how many to measure.

    Returns:
        Decisions, processor time of everything [s], and of the environments alone [s].
    """
    alone = config.environment.model_copy(update={"num_workers": 0})
    env = _TimedVecEnv(make_vector(alone, "train", config.num_envs))
    model = build_model(config, env)
    model.set_logger(Logger(None, []))
    steps = rollout_steps(config)
    model.learn(steps)  # compiles, and takes the environments from their first decisions
    env.seconds, began = 0.0, time.process_time()
    model.learn(updates * steps, reset_num_timesteps=False)
    seconds = time.process_time() - began
    env.close()
    return updates * steps, seconds, env.seconds


def main(
    config: Path = Path("configs/frontiers_ppo.yaml"), worlds: tuple[str, ...] = ("rooms",), updates: Count = 6
) -> None:
    """Measure and print a table.

    Args:
        config: of a training.
        worlds: measured beside that of the configuration.
        updates: how many to measure in each.
    """
    training = read_record(config, TrainingConfig)
    table = Table("world", "decisions/s", "environment alone", "learning and choosing alone")
    for world in (training.environment.world, *worlds):
        environment = training.environment.model_copy(update={"world": world})
        decisions, seconds, stepping = measure(training.model_copy(update={"environment": environment}), updates)
        rates = (decisions / span for span in (seconds, stepping, seconds - stepping))
        table.add_row(world, *(f"{rate:.0f}" for rate in rates))
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
