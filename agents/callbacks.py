"""Callbacks of a training: evaluations, checkpoints, and the progress bar."""

from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import safe_mean

from agents.checkpoint import Checkpoint, save_checkpoint
from agents.config import TrainingConfig
from agents.curves import Row
from agents.evaluation import Episode, Evaluator, summarise
from agents.ppo import capture
from agents.run_folder import list_checkpoints, write_evaluations
from agents.vec_env import EPISODE_MEASURES
from envs.progress import Progress


class RunCallback(BaseCallback):
    """Evaluates the policy and saves checkpoints between updates."""

    model: PPO

    def __init__(
        self, config: TrainingConfig, run: Path, evaluator: Evaluator, evaluations: list[Row], saved_steps: int | None
    ) -> None:
        """Go on from the evaluations so far, to which new ones are appended.

        `saved_steps` are those of the checkpoint that the training goes on from; None at the start.
        """
        super().__init__()
        self._config, self._run, self._evaluator = config, run, evaluator
        self._evaluations, self._saved_steps = evaluations, saved_steps
        self._latest: Checkpoint | None = None

    def save(self) -> str:
        """Save the state before the running rollout, unless that is done; say which one is saved and how to go on."""
        if self._latest is not None and self._latest.record.steps != self._saved_steps:
            save_checkpoint(self._latest, self._run, self._config.checkpoints.keep)
            self._saved_steps = self._latest.record.steps
        if self._saved_steps is None:
            return "before the first step"
        return f"at step {self._saved_steps}, which is saved; --resume {self._run} goes on"

    def diverged(self, what: str = "the network's weights or outputs are not finite") -> ValueError:
        """Return the error that says what is not finite, the remedy, and from where the training can go on."""
        what = f"the training diverged at step {self.num_timesteps}: {what}"
        remedy = f"lower ppo.learning_rate ({self._config.ppo.learning_rate:g}) or the weights of large rewards"
        good = [f"{path} is good, --resume {path} goes on" for path in list_checkpoints(self._run)[-1:]]
        return ValueError("; ".join([what, remedy, *good]))

    def _on_training_start(self) -> None:
        if self._saved_steps is None:
            self._capture()
            self.save()  # Shows right away whether the run folder can be written, before any work could be lost.

    def _on_rollout_start(self) -> None:
        every = self._config.evaluation.every
        past = [int(row["steps"]) for row in self._evaluations if row["policy"] == "ppo"]
        if not past or self.num_timesteps // every > past[-1] // every:
            self._evaluate()
        self._capture()
        # After one more update, the last checkpoint would be older than promised.
        assert self._saved_steps is not None
        if self.num_timesteps + self._config.rollout_steps - self._saved_steps > self._config.checkpoints.every:
            self.save()

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._evaluate()
        self._capture()
        self.save()

    def _on_rollout_end(self) -> None:
        rewards = self.model.rollout_buffer.rewards
        if not np.isfinite(rewards).all():
            step, i = np.argwhere(~np.isfinite(rewards))[0]
            raise self.diverged(f"a reward of sub-environment {i} is {rewards[step, i]}")
        if episodes := self.model.ep_info_buffer:
            for name in EPISODE_MEASURES:
                self.logger.record(f"rollout/{name}", safe_mean([episode[name] for episode in episodes]))

    def _evaluate(self) -> None:
        if not self._evaluations:
            for name in self._config.evaluation.references:
                self._append(name, self._evaluator.explorer(name))
        row = self._append("ppo", self._evaluator.policy(self.model.policy))
        scalars = {f"evaluation/{name}": value for name, value in row.items() if isinstance(value, float)}
        # Not `logger.record`: stable-baselines3 writes that out with the next rollout, and never after the last one.
        for output in self.logger.output_formats:
            output.write(scalars, dict.fromkeys(scalars, ()), self.num_timesteps)
        write_evaluations(self._run, self._evaluations, f"{self._config.experiment}, seed {self._config.seed}")

    def _append(self, policy: str, episodes: list[Episode]) -> Row:
        row: Row = {"policy": policy, "steps": self.num_timesteps, **summarise(episodes)}
        self._evaluations.append(row)
        return row

    def _capture(self) -> None:
        """Keep the state, which changes as soon as the rollout begins."""
        latest = capture(self.model, self._config, self._evaluations)
        if not all(torch.isfinite(tensor).all() for tensor in (*latest.policy.values(), *latest.training.values())):
            raise self.diverged()
        self._latest = latest


class ProgressBar(BaseCallback):
    """Shows steps, their rate, and the explored share of recent training episodes and of the last evaluation."""

    def __init__(self, total_steps: int, evaluations: list[Row]) -> None:
        super().__init__()
        self._total_steps, self._evaluations = total_steps, evaluations
        self._bar = Progress(disable=True)

    def _on_training_start(self) -> None:
        self._bar = Progress(total=self._total_steps, initial=self.num_timesteps, unit="step", smoothing=0.05)

    def _on_step(self) -> bool:
        self._bar.update(self.training_env.num_envs)
        return True

    def _on_rollout_end(self) -> None:
        shown = {}
        if episodes := self.model.ep_info_buffer:
            shown["explored"] = f"{safe_mean([episode['explored_fraction'] for episode in episodes]):.0%}"
        if self._evaluations:
            shown["evaluated"] = f"{self._evaluations[-1]['explored_fraction']:.0%}"
        self._bar.set_postfix(shown, refresh=False)

    def _on_training_end(self) -> None:
        self._bar.close()
