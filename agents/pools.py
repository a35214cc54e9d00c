"""Where functions run side by side: in processes of this machine, or on a Ray cluster."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

from lidarnaut.envs.processes import start_worker, stop_workers


class RayExecutor(Executor):
    """A Ray cluster, on whose machines the project is installed in the same version. Each call takes a core."""

    def __init__(self, address: str) -> None:
        """Connect to the cluster at an address, as `ray.init` takes it (`auto`, `HOST:PORT`, `ray://HOST:PORT`).

        Raises:
            ImportError: if Ray, an extra, is not installed.
        """
        try:
            import ray
        except ImportError as error:
            raise ImportError("--ray needs Ray: pip install 'lidarnaut[ray]', or -e '.[ray]' in a checkout") from error
        self._ray = ray
        ray.init(address=address, log_to_driver=False, configure_logging=False)

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        future: Future = self._ray.remote(num_cpus=1)(function).remote(*args, **kwargs).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which ends what is under way."""
        self._ray.shutdown()


def make_pool(num_workers: int | None, ray: str | None) -> Executor:
    """Return processes of this machine, None for as many as there are cores, or the Ray cluster of an address."""
    if ray is not None:
        return RayExecutor(ray)
    # A fresh interpreter each: forked copies of a process that has threads (torch, numba) may hang.
    return ProcessPoolExecutor(num_workers, multiprocessing.get_context("spawn"), start_worker)


def stop(pool: Executor) -> None:
    """End what is under way in a pool."""
    if isinstance(pool, ProcessPoolExecutor):
        stop_workers(pool)
