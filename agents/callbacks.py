"""Training callback: evaluations, checkpoints and progress bar."""

import json
import logging
import time
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.utils import safe_mean

from lidarnaut.agents.algorithms import Prepared
from lidarnaut.agents.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from lidarnaut.agents.curves import TEST, VALIDATION, Row, curve_of, interval_of
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.replay import ReplayFiles
from lidarnaut.agents.run_folder import BEST, find_checkpoint, list_checkpoints, write_evaluations
from lidarnaut.agents.state import capture
from lidarnaut.agents.trust import named_code, resuming
from lidarnaut.envs.files import write_file
from lidarnaut.envs.processes import interrupts_delayed
from lidarnaut.envs.progress import Progress

LOGGER = logging.getLogger(__name__)
REPORT_STEPS = 1000
"""Minimum number of environment steps between two reports of an off-policy training, whose rollouts are short."""


class RunCallback(BaseCallback):
    """Training callback that evaluates the policy, saves checkpoints and updates the progress bar."""

    model: BaseAlgorithm

    def __init__(
        self,
        prepared: Prepared,
        model: BaseAlgorithm,
        run: Path,
        evaluator: Evaluator,
        checkpoint: Checkpoint | None,
        bar: Progress,
    ) -> None:
        """`checkpoint`: of a resumed run, for its evaluations and its replay buffer."""
        super().__init__()
        self.model, self._run, self._evaluator, self._bar = model, run, evaluator, bar
        self._config, self._rollout_steps = prepared.config, prepared.rollout_steps
        self._num_rollouts, self._began, self._timed = -1, (0, 0.0), np.zeros(2)
        """Finished rollouts with their updates; steps and time [s] at the start of the current one; steps and time [s]
        of all but the first, which compiles kernels and counts only until the second has passed."""
        self._evaluations = curve_of(checkpoint.record.evaluations) if checkpoint else []
        self._saved_steps = model.num_timesteps if checkpoint else None
        self._replay = None
        if isinstance(model, OffPolicyAlgorithm) and model.replay_buffer is not None:
            self._replay = ReplayFiles(model.replay_buffer, run)
            self._replay.read(checkpoint.record.replay if checkpoint else {})
        self._has_news, self._num_ended, self._reported_steps = False, 0, 0
        bar.rate = 0.0  # no estimate yet
        at_start, prior = self._config.evaluation.at_start, getattr(prepared.network, "prior", 0.0)
        self._evaluates_start = prior > 0.0 if at_start is None else at_start
        self._latest: Checkpoint | None = None

    def save(self) -> str:
        """Save the latest resumable state as a checkpoint; return a message with the options to resume."""
        latest = self._latest if self._replay is None else self._capture()
        if latest is not None and latest.record.steps != self._saved_steps:
            if self._replay is not None:
                latest.record.replay = self._replay.write(latest.record.steps // self._config.num_envs)
            with interrupts_delayed():  # a checkpoint that is written counts as saved
                save_checkpoint(latest, self._run, self._config.checkpoints.keep)
                self._saved_steps = latest.record.steps
            if self._replay is not None:
                self._replay.prune(self._run)
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
        self._mark_best()

    def _on_rollout_start(self) -> None:
        self._num_rollouts += 1
        if self._num_rollouts:
            took = np.subtract((self.num_timesteps, time.monotonic()), self._began)
            self._timed = took if self._num_rollouts <= 2 else self._timed + took
            self._bar.rate = float(self._timed[0] / self._timed[1])
        is_off_policy = isinstance(self.model, OffPolicyAlgorithm)
        if self._num_rollouts and self.num_timesteps - self._reported_steps >= (REPORT_STEPS if is_off_policy else 1):
            self._report()
        every = self._config.evaluation.every
        before = int(self._evaluations[-1]["steps"]) if self._evaluations else -int(self._evaluates_start)
        is_due = self.num_timesteps // every > before // every
        if is_due:
            self._latest = None if is_off_policy else self._capture()  # for an interrupt while it is evaluated
            self._evaluate()
        if not is_off_policy:
            self._latest = self._capture()
        # After one more rollout, the last checkpoint would be older than `checkpoints.every`.
        assert self._saved_steps is not None
        is_late = self.num_timesteps + self._rollout_steps - self._saved_steps > self._config.checkpoints.every
        if is_late or (is_due and self._best_step() == self.num_timesteps):
            self.save()
        if is_due:
            self._mark_best()
        self._began = self.num_timesteps, time.monotonic()

    def _on_step(self) -> bool:
        rewards = self.locals["rewards"]
        if not np.isfinite(rewards).all():
            i = int(np.argmin(np.isfinite(rewards)))
            raise self.diverged(f"a reward of sub-environment {i} is {rewards[i]}")
        self._bar.update(self._config.num_envs)
        if self.locals["dones"].any():
            self._has_news, self._num_ended = True, self._num_ended + int(self.locals["dones"].sum())
            headline, (entry, label) = self._evaluator.headline, self._evaluator.shown
            recent = [episode for episode in self.model.ep_info_buffer or () if entry in episode]
            shown = []
            if recent and self._num_ended >= len(rewards):  # the first episodes to end are those that ended early
                shown.append(f"episode return {safe_mean([episode['r'] for episode in recent]):.3g}")
                shown.append(f"training {label} {100.0 * safe_mean([episode[entry] for episode in recent]):.0f} %")
            for value in [row[headline.name] for row in self._evaluations[-1:] if headline.name in row]:
                shown.append(f"validation {headline.label} {headline.text(float(value))} {headline.unit}")
            self._bar.set_postfix_str(", ".join(shown), refresh=False)
        return True

    def _report(self) -> None:
        """Write the values of the last update to loggers, and a line without a terminal."""
        self._reported_steps = self.num_timesteps
        self.logger.dump(self.num_timesteps)
        self._bar.note()

    def _on_rollout_end(self) -> None:
        if self._has_news and self.model.ep_info_buffer:
            for name in sorted(self.model.ep_info_buffer[-1].keys() - {"r", "l", "t"}):
                mean = safe_mean([episode[name] for episode in self.model.ep_info_buffer])
                self.logger.record(f"rollout/{name}", mean)
        self._has_news = False

    def _on_training_end(self) -> None:
        self._report()
        self._evaluate()
        self._latest = self._capture()
        self.save()
        self._mark_best()

    def finish(self, references: list[Row]) -> None:
        """Measure the best checkpoint in the test episodes; write all results. The model gets its weights."""
        folder, headline = find_checkpoint(self._run, "best"), self._evaluator.headline
        trust = named_code(self._config.model_dump())
        self.model.policy.load_state_dict(load_checkpoint(folder, policy_only=True, trust=trust).policy)
        result = {
            "steps": int(folder.name[5:]),
            **self._evaluator.policy(self.model.policy, TEST, progress=not self._bar.disable),
        }
        self._write([*references, *self._evaluations, result])
        for row in (result, *references):
            value, low, high = map(headline.text, (float(row[headline.name]), *interval_of(row, headline.name)))
            of = row["policy"], result["episodes"], headline.title, value, low, high
            LOGGER.info("%s in %d test episodes: %s %s [%s, %s]", *of)

    def _best_step(self) -> int:
        """Return the step of the best validation whose checkpoint exists, or is due; ties go to the later; -1: none."""
        name, sign = self._evaluator.headline.name, -1 if self._evaluator.headline.higher_is_better is False else 1
        kept = {self.num_timesteps, *(int(path.name[5:]) for path in list_checkpoints(self._run))}
        rows = [row for row in self._evaluations if row.get("split") == VALIDATION and row["steps"] in kept]
        scores = [(sign * float(row.get(name, -sign * np.inf)), int(row["steps"])) for row in rows]
        return max(scores, default=(0.0, -1))[1]

    def _mark_best(self) -> None:
        path, step = self._run / "checkpoints" / BEST, self._best_step()
        if step < 0:
            path.unlink(missing_ok=True)
        else:
            write_file(path, json.dumps({"step": step, "by": self._evaluator.headline.name}))

    def _evaluate(self) -> None:
        measured = self._evaluator.policy(self.model.policy, progress=not self._bar.disable)
        row: Row = {"steps": self.num_timesteps, **measured}
        self._evaluations.append(row)
        for name, value in row.items():
            if isinstance(value, float):
                self.logger.record(f"evaluation/{name}", value)
        self.logger.dump(self.num_timesteps)
        self._write(self._evaluations)

    def _write(self, rows: list[Row]) -> None:
        title = f"{self._config.experiment}, {self._config.algorithm}, seed {self._config.seed}"
        write_evaluations(self._run, rows, title)

    def _capture(self) -> Checkpoint:
        latest = capture(self.model, self._config, self._evaluations, self._evaluator.control_hz)
        if not all(torch.isfinite(tensor).all() for tensor in (*latest.policy.values(), *latest.training.values())):
            raise self.diverged()
        return latest
