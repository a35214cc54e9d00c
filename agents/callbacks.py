"""Training callback: evaluations, checkpoints and progress bar."""

from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.utils import safe_mean

from lidarnaut.agents.algorithms import rollout_steps
from lidarnaut.agents.checkpoint import Checkpoint, save_checkpoint
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import LEARNED_NAMES, Row
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.replay import ReplayFiles
from lidarnaut.agents.run_folder import list_checkpoints, write_evaluations
from lidarnaut.agents.state import capture
from lidarnaut.agents.trust import resuming
from lidarnaut.envs.progress import Progress


class RunCallback(BaseCallback):
    """Training callback that evaluates the policy, saves checkpoints and updates the progress bar."""

    model: BaseAlgorithm

    def __init__(
        self,
        config: TrainingConfig,
        run: Path,
        evaluator: Evaluator,
        evaluations: list[Row],
        saved_steps: int | None,
        replay: ReplayFiles | None,
        bar: Progress,
    ) -> None:
        super().__init__()
        self._config, self._run, self._evaluator, self._replay, self._bar = config, run, evaluator, replay, bar
        self._evaluations, self._saved_steps = evaluations, saved_steps
        self._rollout_steps = rollout_steps(config)
        self._has_news = False
        self._latest: Checkpoint | None = None

    def save(self) -> str:
        """Save the latest resumable state as a checkpoint; return a message with the options to resume."""
        latest = self._latest if self._replay is None else self._capture()
        if latest is not None and latest.record.steps != self._saved_steps:
            if self._replay is not None:
                latest.record.replay = self._replay.write(latest.record.steps // self._config.num_envs)
            save_checkpoint(latest, self._run, self._config.checkpoints.keep)
            if self._replay is not None:
                self._replay.prune(self._run)
            self._saved_steps = latest.record.steps
        if self._saved_steps is None:
            return "before the first step"
        return f"at step {self._saved_steps} (saved); resume with {resuming(self._run, self._config.model_dump())}"

    def diverged(self, what: str = "the network's weights or outputs are not finite") -> ValueError:
        rate = self._config.hyperparameters.get("learning_rate", "the library's default")
        what = f"the training diverged at step {self.num_timesteps}: {what}"
        remedy = f"lower hyperparameters.learning_rate ({rate}) or the weights of large rewards"
        record = self._config.model_dump()
        good = [f"resume from {path} with {resuming(path, record)}" for path in list_checkpoints(self._run)[-1:]]
        return ValueError("; ".join([what, remedy, *good]))

    def _on_training_start(self) -> None:
        if self._saved_steps is None:
            self._latest = self._capture()
            self.save()  # detects an unwritable folder early

    def _on_rollout_start(self) -> None:
        every = self._config.evaluation.every
        past = [int(row["steps"]) for row in self._evaluations if row["policy"] in LEARNED_NAMES]
        if not past or self.num_timesteps // every > past[-1] // every:
            self._evaluate()
        if not isinstance(self.model, OffPolicyAlgorithm):
            self._latest = self._capture()
        # After one more rollout, the last checkpoint would be older than `checkpoints.every`.
        assert self._saved_steps is not None
        if self.num_timesteps + self._rollout_steps - self._saved_steps > self._config.checkpoints.every:
            self.save()

    def _on_step(self) -> bool:
        rewards = self.locals["rewards"]
        if not np.isfinite(rewards).all():
            i = int(np.argmin(np.isfinite(rewards)))
            raise self.diverged(f"a reward of sub-environment {i} is {rewards[i]}")
        self._bar.update(self._config.num_envs)
        if self.locals["dones"].any():
            self._has_news = True
            headline, progress, last = self._evaluator.headline, self._evaluator.progress, self._evaluations[-1]
            recent = [episode[progress] for episode in self.model.ep_info_buffer or () if progress in episode]
            shown = {f"training {progress}": f"{safe_mean(recent):.0%}"} if recent else {}
            if headline.name in last:
                shown[f"evaluation {headline.label}"] = f"{headline.text(float(last[headline.name]))} {headline.unit}"
            self._bar.set_postfix(shown, refresh=False)
        return True

    def _on_rollout_end(self) -> None:
        if self._has_news and self.model.ep_info_buffer:
            for name in sorted(self.model.ep_info_buffer[-1].keys() - {"r", "l", "t"}):
                mean = safe_mean([episode[name] for episode in self.model.ep_info_buffer])
                self.logger.record(f"rollout/{name}", mean)
        self._has_news = False

    def _on_training_end(self) -> None:
        self._evaluate()
        self._latest = self._capture()
        self.save()

    def _evaluate(self) -> None:
        if not self._evaluations:
            for name in self._config.evaluation.references:
                self._append(self._evaluator.reference(name))
        row = self._append(self._evaluator.policy(self.model.policy))
        scalars = {f"evaluation/{name}": value for name, value in row.items() if isinstance(value, float)}
        # Not `logger.record`: recorded values are written only with the next rollout.
        for output in self.logger.output_formats:
            output.write(scalars, dict.fromkeys(scalars, ()), self.num_timesteps)
        title = f"{self._config.experiment}, {self._config.algorithm}, seed {self._config.seed}"
        write_evaluations(self._run, self._evaluations, title)

    def _append(self, summary: Row) -> Row:
        row: Row = {"policy": summary["policy"], "steps": self.num_timesteps, **summary}
        self._evaluations.append(row)
        return row

    def _capture(self) -> Checkpoint:
        latest = capture(self.model, self._config, self._evaluations, self._evaluator.control_hz)
        if not all(torch.isfinite(tensor).all() for tensor in (*latest.policy.values(), *latest.training.values())):
            raise self.diverged()
        return latest
