"""Evaluation of the network of a policy on several threads."""

import copy
import inspect
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.modules.batchnorm import _BatchNorm
from torch.nn.modules.dropout import _DropoutNd

MIN_ROWS, MAX_PART = 128, 512
"""Minimum number of samples of a batch that is split, and maximum number of samples of a part."""
UNSPLIT = _BatchNorm | _DropoutNd
"""Layers whose output depends on the whole batch, or on random numbers."""


class Threads:
    """Threads that evaluate parts of batches. The split, and so the result, is independent of their number."""

    def __init__(self, count: int) -> None:
        self._count = count
        # Each thread of Python has its own number of threads of torch.
        self._pool = ThreadPoolExecutor(max(count - 1, 1), "network", torch.set_num_threads, (1,))

    def map(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """Return the results of `function` for all `items`, in their order."""
        results: list[Any] = [None] * len(items)

        def work(first: int) -> None:
            for i in range(first, len(items), self._count):
                results[i] = function(items[i])

        others = [self._pool.submit(work, first) for first in range(1, min(self._count, len(items)))]
        work(0)
        for other in others:
            other.result()
        return results


def split_batches(policy: Any, num_threads: int) -> None:
    """Let an on-policy policy evaluate large batches in parts, on `num_threads` threads.

    Gradients of `evaluate_actions` are computed in parts too, and summed in a fixed order. Recurrent policies, whose
    training batches are sequences, are split in rollouts only.
    """
    if policy.squash_output or any(isinstance(module, UNSPLIT) for module in policy.modules()):
        return
    threads = Threads(num_threads)
    for module in [policy.network] if hasattr(policy, "network") else [*policy.modules()]:
        if hasattr(policy, "network") or isinstance(module, BaseFeaturesExtractor):
            module.forward = partial(_act, threads, module.forward)
    if inspect.signature(policy.evaluate_actions).parameters.keys() <= {"obs", "actions", "action_masks"}:
        policy.evaluate_actions = partial(_evaluate, threads, policy)


def _act(threads: Threads, forward: Callable[..., Any], observations: Any) -> Any:
    if torch.is_grad_enabled() or (parts := _split((observations,))) is None:
        return forward(observations)
    outputs = threads.map(torch.no_grad()(lambda part: forward(*part)), parts)
    return torch.cat(outputs) if isinstance(outputs[0], Tensor) else tuple(map(torch.cat, zip(*outputs)))


def _evaluate(threads: Threads, policy: Any, *arguments: Any, **masks: Any) -> tuple[Tensor, ...]:
    names, values = tuple(masks), (*arguments, *masks.values())

    def evaluate(part: Sequence[Any]) -> Any:
        own = copy.copy(policy)  # its distribution keeps the numbers of the last batch
        own.action_dist = copy.copy(policy.action_dist)
        named = dict(zip(names, part[len(arguments) :]))
        return type(policy).evaluate_actions(own, *part[: len(arguments)], **named)

    if not torch.is_grad_enabled() or (parts := _split(values)) is None:
        return evaluate(values)
    weights = [weight for weight in policy.parameters() if weight.requires_grad]
    return _Parts.apply(threads, evaluate, parts, *weights)


class _Parts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, threads: Threads, evaluate: Any, parts: Any, *weights: Tensor) -> tuple[Tensor, ...]:
        outputs = threads.map(torch.enable_grad()(evaluate), parts)
        ctx.threads, ctx.outputs, ctx.weights = threads, outputs, weights
        return tuple(torch.cat([one.detach() for one in column]) for column in zip(*outputs))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        sizes, weights = [len(output[0]) for output in ctx.outputs], ctx.weights
        shares = zip(*(gradient.split(sizes) for gradient in gradients))

        def propagate(part: tuple[Any, Any]) -> tuple[Tensor, ...]:
            return torch.autograd.grad(part[0], weights, part[1], materialize_grads=True)

        sums, *others = ctx.threads.map(propagate, [*zip(ctx.outputs, shares)])
        for other in others:
            sums = tuple(torch._foreach_add(sums, other))
        return None, None, None, *sums


def _split(values: Sequence[Any]) -> list[list[Any]] | None:
    count = len(next(iter(values[0].values())) if isinstance(values[0], dict) else values[0])
    if count < MIN_ROWS:
        return None
    size = -(-count // max(2, -(-count // MAX_PART)))

    def take(value: Any, rows: slice) -> Any:
        if isinstance(value, dict):
            return {name: one[rows] for name, one in value.items()}
        return value if value is None else value[rows]

    return [[take(value, slice(first, first + size)) for value in values] for first in range(0, count, size)]
