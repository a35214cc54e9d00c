"""Parallel execution in local processes or on a Ray cluster."""

import contextlib
import glob
import multiprocessing
import os
import platform
import socket
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from lidarnaut.agents.trust import leaves
from lidarnaut.envs.files import read_bytes, read_mapping
from lidarnaut.envs.processes import start_worker

CONNECT_LIMIT = 10.0
"""Timeout for connecting to a Ray cluster [s]."""
_entered: list[tempfile.TemporaryDirectory[str] | None] = []


class RayExecutor(Executor):
    """`concurrent.futures` executor on a Ray cluster; each call uses one core.

    All machines need the same package version. Required files are sent with the calls.
    """

    def __init__(self, address: str, named: Any = ()) -> None:
        """Connect to a cluster at `auto`, `HOST:PORT` or `ray://HOST:PORT`; `named`: configuration with files to send.

        Raises:
            ImportError: if Ray is not installed.
            ConnectionError: if no cluster answers.
        """
        try:
            import ray
        except ImportError as error:
            raise ImportError("--ray needs Ray: pip install 'lidarnaut[ray]', or -e '.[ray]' in a checkout") from error
        # In this process, Ray would retry for minutes and ignore Ctrl-C.
        command = [sys.executable, "-c", "import ray, sys; ray.init(sys.argv[1], log_to_driver=False)", address]
        host, _, port = address.removeprefix("ray://").rpartition(":")
        try:
            if port.isdigit():
                socket.create_connection((host.strip("[]"), int(port)), CONNECT_LIMIT / 2).close()
            subprocess.run(command, capture_output=True, text=True, timeout=CONNECT_LIMIT, check=True)
            why = ""
        except subprocess.CalledProcessError as error:
            why = " ".join(error.stderr.rpartition("Error: ")[2].split()) or "Ray failed"
        except subprocess.TimeoutExpired:
            why = f"none within {CONNECT_LIMIT:.0f} s"
        except (OSError, OverflowError) as error:
            why = str(error)
        if why:
            raise ConnectionError(f"--ray {address}: no cluster answers: {why}")
        ray.init(address=address, log_to_driver=False, configure_logging=False)
        self._ray = ray
        self._files = ray.put((os.getcwd(), dict(collect_files(named))))

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        future: Future = Future()

        def take(inner: Future) -> None:
            if (error := inner.exception()) is None:
                future.set_result(inner.result())
            else:
                future.set_exception(getattr(error, "cause", None) or error)

        call = self._ray.cloudpickle.dumps((function, args, kwargs))
        self._ray.remote(num_cpus=1)(_call).remote(self._files, call).future().add_done_callback(take)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._ray.shutdown()


def _call(files: tuple[str, Mapping[str, bytes]], call: bytes) -> Any:
    from ray import cloudpickle

    if not _entered:
        _entered.append(enter_folder(*files))
    function, args, kwargs = cloudpickle.loads(call)
    return function(*args, **kwargs)


def collect_files(named: Any) -> Iterator[tuple[str, bytes]]:
    """Yield path and content of the files that remote machines need to execute calls.

    These are files and policy folders named in the configuration `named`, images of such map files, and modules
    imported from the current folder.
    """
    here, paths = os.getcwd() + os.sep, []
    for text in {str(one) for _, one in leaves(named) if isinstance(one, str | os.PathLike)} - {""}:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            paths += [text, *glob.glob(f"{glob.escape(text)}/*.json"), *glob.glob(f"{glob.escape(text)}/*.safetensors")]
            paths.append(os.path.join(os.path.dirname(text), read_mapping(text)["image"]))
    installed = sysconfig.get_path("stdlib"), sysconfig.get_path("purelib"), str(Path(__file__).parents[1])
    for module in list(sys.modules.values()):
        file = str(getattr(module, "__file__", ""))
        paths += [file.removeprefix(here)] if file.startswith(here) and not file.startswith(installed) else []
    for path in filter(os.path.isfile, paths):
        yield path, read_bytes(Path(path))


def enter_folder(folder: str, files: Mapping[str, bytes]) -> tempfile.TemporaryDirectory[str] | None:
    """Change to the working folder of the calling machine, or to a temporary copy if files are missing or different.

    `files`: required content by path. Returns the temporary folder, or None.

    Raises:
        ValueError: if a file with an absolute path is missing or different.
    """
    files_here = {path: Path(folder, path) for path in files}
    wrong = [path for path, file in files_here.items() if not file.is_file() or read_bytes(file) != files[path]]
    for path in filter(os.path.isabs, wrong):
        raise ValueError(f"on {platform.node()}, {path} is missing or different; relative paths work on every machine")
    copy = None
    if wrong or not os.path.isdir(folder):
        copy = tempfile.TemporaryDirectory(prefix="lidarnaut_", ignore_cleanup_errors=True)
        os.makedirs(copy.name + folder)
        for path, content in files.items():
            file = Path(copy.name + os.path.normpath(os.path.join(folder, path)))
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    sys.path[:] = [path for path in sys.path if path != folder]
    folder = copy.name + folder if copy else folder
    os.chdir(folder)
    sys.path.append(folder)
    return copy


@contextlib.contextmanager
def make_pool(num_workers: int | None, ray: str | None, named: Any = ()) -> Iterator[Executor]:
    """Yield an executor that runs calls in local processes, or on the Ray cluster at address `ray`.

    `num_workers`: number of local processes, by default one per core. `named`: configuration; files named in it are
    sent to the cluster. Exceptions cancel running calls.
    """
    # Forked copies of processes with threads (torch, numba) may deadlock.
    spawn = multiprocessing.get_context("spawn")
    with RayExecutor(ray, named) if ray is not None else ProcessPoolExecutor(num_workers, spawn, start_worker) as pool:
        try:
            yield pool
        except BaseException:
            for process in list((getattr(pool, "_processes", None) or {}).values()):
                process.terminate()
            raise
