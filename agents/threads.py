"""Evaluation of the network of a policy on one thread or several."""

import contextlib
import copy
import inspect
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

MIN_ROWS, MAX_PART = 600, 512
"""Minimum number of samples of a batch that is split, and maximum number of samples of a part."""
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, which suits single observations; the process keeps its number of threads."""
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(count)


def split_batches(policy: Any, num_threads: int) -> None:
    """Let an on-policy policy evaluate large batches in parts, on `num_threads` threads.

    The parts are the same for any number of threads. Gradients of `evaluate_actions` are computed in parts too, and
    summed in a fixed order. Recurrent policies, whose training batches are sequences, are split in rollouts only.
    """
    whole = nn.modules.batchnorm._BatchNorm | nn.modules.dropout._DropoutNd  # the batch, or random numbers
    if policy.squash_output or any(isinstance(module, whole) for module in policy.modules()):
        return
    # torch sets its number of threads for each thread of Python.
    run: Map = map if num_threads == 1 else ThreadPoolExecutor(num_threads, "network", torch.set_num_threads, (1,)).map
    extractors = [module for module in policy.modules() if isinstance(module, BaseFeaturesExtractor)]
    for module in [policy.network] if hasattr(policy, "network") else extractors:
        module.forward = partial(_forward, run, module.forward)
    weights = list(policy.parameters())
    policy.parameters = lambda recurse=True: iter(weights)  # many modules are searched for each minibatch
    if inspect.signature(policy.evaluate_actions).parameters.keys() <= {"obs", "actions", "action_masks"}:
        policy.evaluate_actions = partial(_evaluate, run, policy)


def _forward(run: Map, forward: Callable[[Any], Any], observations: Any) -> Any:
    if torch.is_grad_enabled() or len(parts := _split(observations)) == 1:
        return forward(observations)
    outputs = list(run(torch.no_grad()(forward), parts))
    return torch.cat(outputs) if isinstance(outputs[0], Tensor) else tuple(map(torch.cat, zip(*outputs)))


def _evaluate(run: Map, policy: Any, obs: Any, actions: Tensor, action_masks: Any = None) -> tuple[Tensor, ...]:
    masks = [] if action_masks is None else [torch.as_tensor(action_masks)]

    def evaluate(part: Any) -> Any:
        own = copy.copy(policy)
        own.action_dist = copy.copy(policy.action_dist)  # keeps numbers of its last batch
        return type(policy).evaluate_actions(own, *part)

    parts = [*zip(*map(_split, (obs, actions, *masks)))]
    weights = [weight for weight in policy.parameters() if weight.requires_grad]
    return _Parts.apply(run, evaluate, parts, *weights) if len(parts) > 1 else evaluate(parts[0])


class _Parts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, run: Map, evaluate: Any, parts: Any, *weights: Tensor) -> tuple[Tensor, ...]:
        ctx.run, ctx.weights, ctx.outputs = run, weights, list(run(torch.enable_grad()(evaluate), parts))
        return tuple(torch.cat([one.detach() for one in column]) for column in zip(*ctx.outputs))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        sizes = [len(output[0]) for output in ctx.outputs]
        shares = zip(*(gradient.split(sizes) for gradient in gradients))

        def propagate(part: tuple[Any, Any]) -> tuple[Tensor, ...]:
            return torch.autograd.grad(part[0], ctx.weights, part[1], materialize_grads=True)

        sums, *others = ctx.run(propagate, [*zip(ctx.outputs, shares)])
        for other in others:
            sums = tuple(torch._foreach_add(sums, other))
        return None, None, None, *sums


def _split(batch: Any) -> list[Any]:
    if isinstance(batch, dict):
        columns = [_split(column) for column in batch.values()]
        return [dict(zip(batch, part, strict=True)) for part in zip(*columns, strict=True)]
    count = len(batch)
    return list(batch.split(-(-count // max(2, -(-count // MAX_PART))))) if count >= MIN_ROWS else [batch]
