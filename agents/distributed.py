"""Training in several processes, which average the gradients of each minibatch.

Each process steps its own sub-environments, after DD-PPO (Wijmans et al., "DD-PPO: learning near-perfect PointGoal
navigators", 2020). Processes are started here, and exchange gradients through shared memory, or by `torchrun`.
"""

import contextlib
import ctypes
import multiprocessing
import os
import signal
from collections.abc import Iterator
from datetime import timedelta
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from torch import Tensor
from torch import distributed as dist

from lidarnaut.envs.processes import follow_parent, interrupts_held

CHUNK = 2**18
"""Number of numbers that are averaged at a time."""
SPINS = 2000
"""Number of attempts before a process sleeps until another one has written its numbers; about 2 ms."""


class EndedError(RuntimeError):
    """Error if another process of the training has failed, or was killed."""


class Alone:
    """A single process."""

    rank, size = 0, 1

    def average(self, numbers: Tensor) -> None:
        """Replace numbers, float32, contiguous, by their means over all processes; the same bytes in each."""

    def share(self, given: Any) -> Any:
        """Return the object of process 0, in all processes that `torchrun` has started."""
        return given


class Local(Alone):
    """Processes of this computer, which average numbers in shared memory."""

    def __init__(self, rank: int, size: int, shared: Any, posts: Any, pipes: Any = (), processes: Any = ()) -> None:
        self.rank, self.size = rank, size
        self._slots = torch.frombuffer(shared, dtype=torch.float32).view(2, size, CHUNK)
        self._posts, self._pipes, self._processes, self._turn = posts, pipes, processes, 0

    def average(self, numbers: Tensor) -> None:
        for part in numbers.split(CHUNK):
            # A process is at most one turn ahead of the slowest: two sets of slots suffice.
            self._turn ^= 1
            slots = self._slots[self._turn, :, : len(part)]
            slots[self.rank] = part
            others = [k for k in range(self.size) if k != self.rank]
            for k in others:
                self._posts[self.rank][k].release()
            for k in others:
                self._wait(self._posts[k][self.rank])
            _mean(slots, part)

    def _wait(self, post: Any) -> None:
        if not any(post.acquire(False) for _ in range(SPINS)):
            while not post.acquire(timeout=0.5):
                self.check()

    def check(self) -> None:
        """Raise EndedError if another process has ended; only process 0 does so."""
        for k, (process, pipe) in enumerate(zip(self._processes, self._pipes, strict=False), 1):
            with contextlib.suppress(EOFError, OSError):
                if pipe.poll():
                    raise EndedError(f"process {k} of the training: {pipe.recv()}")
            if not process.is_alive():
                raise EndedError(f"process {k} of the training has ended with exit code {process.exitcode}")


class Remote(Alone):
    """Processes that `torchrun` has started, perhaps on several computers."""

    def __init__(self) -> None:
        dist.init_process_group("gloo", timeout=timedelta(days=7))  # others wait during evaluations
        self.rank, self.size = dist.get_rank(), dist.get_world_size()

    def average(self, numbers: Tensor) -> None:
        # Not `all_reduce`, whose order of summation depends on the network.
        slots = numbers.new_empty(self.size, len(numbers))
        try:
            dist.all_gather(list(slots), numbers)
        except RuntimeError as error:
            raise EndedError(f"a process of the training has ended: {error}") from error
        _mean(slots, numbers)

    def share(self, given: Any) -> Any:
        objects = [given]
        dist.broadcast_object_list(objects, src=0)
        return objects[0]


def _mean(slots: Tensor, out: Tensor) -> None:
    torch.add(slots[0], slots[1], out=out)  # in the order of processes, for the same bytes in each
    for slot in slots[2:]:
        out += slot
    out /= len(slots)


def world_size() -> int:
    """Return the number of processes that `torchrun` has started; 0 without it."""
    return int(os.environ["WORLD_SIZE"]) if dist.is_torchelastic_launched() else 0


@contextlib.contextmanager
def group_of(size: int, job: tuple[Any, ...] = ()) -> Iterator[Alone]:
    """Yield the group of a training in `size` processes: those of `torchrun`, or new ones, which `follow` by `job`."""
    if world_size():
        yield Remote()
        dist.destroy_process_group()
        return
    if size == 1:
        yield Alone()
        return
    context = multiprocessing.get_context("spawn")
    shared = context.RawArray(ctypes.c_float, 2 * size * CHUNK)
    posts = [[context.Semaphore(0) for _ in range(size)] for _ in range(size)]
    ends = [context.Pipe(duplex=False) for _ in range(1, size)]
    starts = enumerate(ends, 1)
    processes = [context.Process(target=_run, args=(end[1], job, k, size, shared, posts)) for k, end in starts]
    try:
        with interrupts_held():
            for process, (_, far_end) in zip(processes, ends, strict=True):
                process.start()
                far_end.close()
        yield Local(0, size, shared, posts, [end for end, _ in ends], processes)
        for process in processes:
            process.join(10.0)
    finally:
        for process in processes:
            if process.is_alive():
                process.terminate()
                process.join(10.0)


def _run(pipe: Any, job: tuple[Any, ...], *group: Any) -> None:
    from lidarnaut.agents.learning import follow

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # process 0 handles Ctrl-C
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    follow_parent()
    try:
        follow(Local(*group), *job)
    except Exception as error:
        pipe.send(" ".join(f"{type(error).__name__}: {error}".split()))
        raise SystemExit(1) from error


class Share(BaseCallback):
    """Callback that counts the steps of all processes, and lets them learn together."""

    def __init__(self, model: BaseAlgorithm, group: Alone) -> None:
        """Average gradients, KL divergences, and means and deviations of advantages over the processes of a group."""
        super().__init__()
        self._group, self._is_waiting, algorithm = group, False, cast(Any, model)
        # Checkpoints do not hold episodes: resumed trainings start new ones.
        state = [algorithm.seed, model.num_timesteps, *([group.rank] if group.rank else [])]
        seed = int(np.random.SeedSequence(state).generate_state(1)[0] >> 1)
        algorithm.env.seed(seed)
        if group.size == 1:
            return
        torch.manual_seed(seed)  # of samples of actions; weights are equal
        np.random.seed(seed)  # noqa: NPY002
        self._weights = [weight for weight in model.policy.parameters() if weight.requires_grad]
        self._flat = torch.empty(sum(weight.numel() for weight in self._weights))
        parts = self._flat.split([weight.numel() for weight in self._weights])
        self._parts = [part.view_as(weight) for part, weight in zip(parts, self._weights, strict=True)]
        for weight in self._weights:
            weight.register_post_accumulate_grad_hook(self._note)
        if getattr(algorithm, "target_kl", None) is not None:
            algorithm.target_kl = Limit(algorithm.target_kl, group)
        if getattr(algorithm, "normalize_advantage", False):
            algorithm.normalize_advantage = False
            algorithm.rollout_buffer.get = partial(_normalized, algorithm.rollout_buffer.get, group)

    def _on_step(self) -> bool:
        rewards = self.locals["rewards"]
        if self._group.rank and not np.isfinite(rewards).all():
            i = int(np.argmin(np.isfinite(rewards)))
            raise ValueError(f"a reward of sub-environment {i + self._group.rank * len(rewards)} is {rewards[i]}")
        self.model.num_timesteps += (self._group.size - 1) * len(rewards)
        return True

    def _note(self, weight: Tensor) -> None:
        if not self._is_waiting:
            self._is_waiting = True
            torch.autograd.Variable._execution_engine.queue_callback(self._average)  # at the end of `backward`

    def _average(self) -> None:
        self._is_waiting = False
        used = [(w.grad, part) for w, part in zip(self._weights, self._parts, strict=True) if w.grad is not None]
        gradients, parts = [list(column) for column in zip(*used, strict=True)]
        torch._foreach_copy_(parts, gradients)
        self._group.average(self._flat)
        torch._foreach_copy_(gradients, parts)


class Limit:
    """Limit that all processes compare with the mean of their numbers, so that all decide alike."""

    __array_ufunc__ = None  # arrays leave comparisons to this class

    def __init__(self, value: float, group: Alone) -> None:
        self._value, self._group = value, group

    def __rmul__(self, factor: float) -> "Limit":
        return Limit(factor * self._value, self._group)

    def __lt__(self, number: Any) -> bool:
        mean = torch.tensor([float(number)])
        self._group.average(mean)
        return float(mean) > self._value


def _normalized(get: Any, group: Alone, batch_size: int | None = None) -> Iterator[Any]:
    """Yield minibatches with advantages normalized over those of all processes."""
    for batch in get(batch_size):
        advantages = batch.advantages
        counted = advantages[batch.mask > 1e-8] if hasattr(batch, "mask") else advantages
        sums = torch.stack([counted.new_tensor(counted.numel()), counted.sum(), counted.square().sum()])
        group.average(sums)
        count, total, squares = sums.double().tolist()
        mean, variance = total / count, squares / count - (total / count) ** 2
        size = count * group.size
        yield batch._replace(advantages=(advantages - mean) / (max(variance * size / (size - 1), 0.0) ** 0.5 + 1e-8))
