"""Episodes on the machines of a Ray cluster. Ray is an extra: nothing else of the project imports it."""

from collections.abc import Iterator

from benchmarks.arena.workers import Result, Task, run_in_worker

MAX_RETRIES = 1
"""How often an episode whose machine or process has died is tried again."""


def run_on_ray(tasks: list[Task], address: str) -> Iterator[Result]:
    """Yield the results of tasks as they end; rows and traces come back to this process.

    The project must be installed on every machine, in the same version, and checkpoints of learned policies must lie
    there under the same path. Ray keeps worker processes, and with them the environments, between tasks.

    Args:
        tasks: what to run.
        address: of the cluster, as `ray.init` takes it (`auto`, `HOST:PORT`, `ray://HOST:PORT`).

    Raises:
        ImportError: if Ray is not installed.
        ConnectionError: if there is no cluster at the address.
    """
    try:
        import ray
    except ImportError as error:
        raise ImportError("--ray needs Ray: pip install 'lidarnaut[ray]', or -e '.[ray]' in a checkout") from error
    ray.init(address=address, log_to_driver=False, configure_logging=False)
    try:
        # Ray gives a process as many threads as it has cores for it: one.
        run = ray.remote(num_cpus=1, max_retries=MAX_RETRIES)(run_in_worker)
        pending = {run.remote(task): task for task in tasks}
        while pending:
            (done,), _ = ray.wait(list(pending), num_returns=1)
            task = pending.pop(done)
            try:
                yield ray.get(done)
            except ray.exceptions.RayError as error:
                yield Result(task.key, reason=f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")
    finally:
        ray.shutdown()
