"""Where functions run side by side: in processes of this machine, or on a Ray cluster."""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Protocol, Self

from envs.processes import start_worker, stop_workers


class Pending(Protocol):
    """A call that is under way."""

    def result(self) -> Any:
        """Wait for the call, and return what it returns, or raise what it raises."""


class Pool(Protocol):
    """Calls functions somewhere else."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *_: Any) -> bool | None: ...
    def submit(self, function: Callable[..., Any], /, *args: Any) -> Pending:
        """Begin a call."""

    def map(self, function: Callable[..., Any], *values: Iterable[Any]) -> Iterator[Any]:
        """Return what a function returns for each of some values, in their order."""

    def stop(self) -> None:
        """End what is under way."""


class ProcessPool(ProcessPoolExecutor):
    """Processes of this machine."""

    def __init__(self, num_workers: int | None) -> None:
        """Start as many processes as asked for; None takes as many as there are cores."""
        super().__init__(num_workers, multiprocessing.get_context("spawn"), start_worker)

    def stop(self) -> None:
        """End the processes."""
        stop_workers(self)


class RayPool:
    """A Ray cluster, on whose machines the project is installed in the same version."""

    def __init__(self, address: str) -> None:
        """Take the address, as `ray.init` takes it (`auto`, `HOST:PORT`, `ray://HOST:PORT`).

        Raises:
            ImportError: if Ray, an extra, is not installed.
        """
        try:
            import ray
        except ImportError as error:
            raise ImportError("--ray needs Ray: pip install 'lidarnaut[ray]', or -e '.[ray]' in a checkout") from error
        self._ray, self._address = ray, address

    def __enter__(self) -> Self:
        """Connect to the cluster."""
        self._ray.init(address=self._address, log_to_driver=False, configure_logging=False)
        return self

    def __exit__(self, *_: Any) -> None:
        """Leave the cluster, which ends what is under way."""
        self._ray.shutdown()

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Pending:
        """Begin a call, with one core."""
        return _RayCall(self._ray, self._ray.remote(num_cpus=1)(function).remote(*args))

    def map(self, function: Callable[..., Any], *values: Iterable[Any]) -> Iterator[Any]:
        """Return what a function returns for each of some values, in their order."""
        calls = [self.submit(function, *args) for args in zip(*values, strict=True)]
        return (call.result() for call in calls)

    def stop(self) -> None:
        """Do nothing: leaving the cluster ends what is under way."""


class _RayCall:
    def __init__(self, ray: Any, reference: Any) -> None:
        self._ray, self._reference = ray, reference

    def result(self) -> Any:
        return self._ray.get(self._reference)


def make_pool(num_workers: int | None, ray: str | None) -> Pool:
    """Return processes of this machine, or the Ray cluster of an address."""
    return ProcessPool(num_workers) if ray is None else RayPool(ray)
