"""Training of a policy by reinforcement learning."""

import contextlib
import json
import logging
import multiprocessing
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from lidarnaut.agents.algorithms import Prepared, build_model, find_algorithm, num_processes, prepare, takes_vectors
from lidarnaut.agents.callbacks import RunCallback
from lidarnaut.agents.checkpoint import Checkpoint, load_checkpoint
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.distributed import Alone, EndedError, Share, group_of
from lidarnaut.agents.evaluation import REFERENCES, Evaluator, evaluation_environment
from lidarnaut.agents.loggers import LOGGERS, check_loggers
from lidarnaut.agents.resume import check_changes
from lidarnaut.agents.run_folder import discard_after, find_checkpoint, is_measured, new_run, prepare_folder
from lidarnaut.agents.state import check_spaces, is_finite, restore
from lidarnaut.agents.trust import named_code
from lidarnaut.agents.vec_env import GymnasiumVecEnv, make_env, make_vec_env
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import Lock, own_folder, write_file
from lidarnaut.envs.processes import is_interrupt
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.vector.workers import UNGUARDED

LOGGER = logging.getLogger(__name__)
REWARD = "reward.json"
"""File of a run folder with class and effective weights of the reward."""


def run_training(
    config: TrainingConfig,
    *,
    run: Path | None = None,
    resume: Path | None = None,
    trust: Iterable[str] = (),
    progress: bool = True,
) -> Path:
    """Train a policy with a complete configuration, see `lidarnaut.train`; return the run folder.

    `resume`: run or checkpoint folder. `trust`: names of code that the checkpoint may import, besides those in
    `config`.
    """
    source = checkpoint = None
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise RuntimeError(f"a worker process imports the script that trains{UNGUARDED}")
    check_loggers(config.logger)
    with contextlib.ExitStack() as held:
        if resume is not None:
            held.enter_context(Lock(own_folder(find_checkpoint(resume).parent.parent)))
            source = find_checkpoint(resume)  # again, after locking
            checkpoint = load_checkpoint(source, trust=[*trust, *named_code(config.model_dump())])
            check_changes(config, "training", source, checkpoint.record.config)
        size = num_processes(config, find_algorithm(config.algorithm))
        config = config.model_copy(update={"processes": size})
        job = config, source, tuple(trust)
        group = held.enter_context(group_of(size, job))
        group.share(job)
        evaluator = held.enter_context(contextlib.closing(Evaluator(config)))
        prepared, model, env = build(config, held)
        config = prepared.config
        references = evaluator.mark(config.evaluation.references)
        if checkpoint is None or source is None:
            run = held.enter_context(new_run(config, run))
        else:
            run = _resume(config, model, env, checkpoint, source)
            evaluator.finished_references(run)  # A damaged file is found before the first step.
        write_reward(run, config)
        number = config.evaluation.test_episodes or config.evaluation.episodes
        LOGGER.info("test after the training: %d episodes each of %s", number, ", ".join(("the best", *references)))
        total_steps, steps = prepared.num_updates * prepared.rollout_steps, model.num_timesteps
        is_open = steps < total_steps or not is_measured(run)
        bar = Progress(total=total_steps, initial=steps, unit="step", disable=not (progress and is_open))
        keeper, share = RunCallback(prepared, model, run, evaluator, checkpoint, bar), Share(model, group)
        group.share(run)
        model.set_logger(Logger(str(run), [LOGGERS[name](run, steps + 1 if steps else None) for name in config.logger]))
        held.callback(model.logger.close)
        if is_open:
            with _saved_at_end(keeper):
                with bar:
                    if steps < total_steps:
                        model.learn(total_steps - steps, [share, keeper], reset_num_timesteps=False)
                keeper.finish(evaluator.references(references, run, progress=progress))
    return run


def _resume(
    config: TrainingConfig, model: BaseAlgorithm, env: GymnasiumVecEnv, checkpoint: Checkpoint, source: Path
) -> Path:
    """Restore a model from a checkpoint; return the run folder, prepared for a configuration."""
    before = checkpoint.record.config
    check_changes(config, "training", source, before)
    if (number := before.processes or 1) != config.processes:
        LOGGER.info("%d processes train; before, %d did: weights will differ", config.processes, number)
    _restore(model, env, checkpoint, source)
    run = discard_after(source)
    prepare_folder(run, config)
    if evaluation_environment(config).arguments != evaluation_environment(before).arguments:
        (run / REFERENCES).unlink(missing_ok=True)
    return run


@contextlib.contextmanager
def _saved_at_end(keeper: RunCallback) -> Iterator[None]:
    """Save the state of an interrupted training, and explain errors of other processes and of divergence."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(keeper.save()) from None
    except SystemError as error:
        if is_interrupt(error):
            raise KeyboardInterrupt(keeper.save()) from None
        raise
    except EndedError as error:
        raise ValueError(f"{error}; the training ended {keeper.save()}") from error
    except ValueError:  # of distributions with such parameters, among others
        if is_finite(keeper.model):
            raise
        raise keeper.diverged() from None


def write_reward(run: Path, config: TrainingConfig) -> None:
    """Write class and effective weights of the reward to `reward.json` of a run folder, and log them."""
    with contextlib.closing(make_env(config.environment, "train")) as env:
        rewards = lidar_env_of(env).task.rewards
    name = f"{type(rewards).__module__}:{type(rewards).__qualname__}"
    write_file(run / REWARD, json.dumps({"class": name, "weights": rewards.weights}, indent=1) + "\n")
    LOGGER.info("reward %s: %s", name, ", ".join(f"{term} {weight:g}" for term, weight in rewards.weights.items()))


def follow_remotely() -> Path:
    """Train as a process that `torchrun` has started, beside process 0; return the run folder."""
    with group_of(0) as group:
        return follow(group, *group.share(None))


def follow(group: Alone, config: TrainingConfig, source: Path | None, trust: tuple[str, ...]) -> Any:
    """Train with process 0 of a group, which evaluates the policy and writes the run folder.

    `source`: checkpoint to resume. `trust`: names of code that it may import. Returns the run folder in processes of
    `torchrun`, None in others.
    """
    with contextlib.ExitStack() as held:
        prepared, model, env = build(config, held)
        if source is not None:
            checkpoint = load_checkpoint(source, trust=[*trust, *named_code(config.model_dump())])
            _restore(model, env, checkpoint, source)
        model.set_logger(Logger(None, []))
        share, run = Share(model, group), group.share(None)
        left = prepared.num_updates * prepared.rollout_steps - model.num_timesteps
        if left > 0:
            model.learn(left, share, reset_num_timesteps=False)
    return run


def build(config: TrainingConfig, held: contextlib.ExitStack) -> tuple[Prepared, BaseAlgorithm, GymnasiumVecEnv]:
    """Return the algorithm and the sub-environments of one process."""
    algorithm = find_algorithm(config.algorithm)
    env = held.enter_context(contextlib.closing(make_vec_env(config, is_flat=takes_vectors(algorithm))))
    prepared = prepare(config, algorithm, env)
    held.callback(torch.set_num_threads, torch.get_num_threads())  # `build_model` changes it
    return prepared, build_model(prepared, env), env


def _restore(model: BaseAlgorithm, env: GymnasiumVecEnv, checkpoint: Checkpoint, source: Path) -> None:
    check_spaces(checkpoint.record, env.parts.spaces, env.action_space, str(source))
    restore(model, checkpoint, source)
