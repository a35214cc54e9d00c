"""Where functions run side by side: in processes of this machine, or on a Ray cluster."""

import contextlib
import glob
import json
import multiprocessing
import os
import platform
import re
import socket
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from lidarnaut.envs.files import read_bytes, read_mapping
from lidarnaut.envs.processes import start_worker, stop_workers

CONNECT_LIMIT = 10.0
"""Longest wait for a Ray cluster [s]."""
_entered: list[tempfile.TemporaryDirectory[str] | None] = []
"""Result of `enter_folder` in a worker of a cluster, once it is there."""


class RayExecutor(Executor):
    """A Ray cluster, on whose machines the project is installed in the same version. Each call takes a core.

    Files travel with the calls, see `collect_files` and `enter_folder`.
    """

    def __init__(self, address: str, named: Any = ()) -> None:
        """Connect to the cluster at an address, as `ray.init` takes it (`auto`, `HOST:PORT`, `ray://HOST:PORT`).

        `named` holds the names of files that calls read, see `collect_files`.

        Raises:
            ImportError: Ray, an extra, is not installed.
            ConnectionError: no cluster answers at the address.
        """
        try:
            import ray
        except ImportError as error:
            raise ImportError("--ray needs Ray: pip install 'lidarnaut[ray]', or -e '.[ray]' in a checkout") from error
        # In this process, Ray would try for minutes, log to the terminal, and ignore Ctrl-C.
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
            else:  # The text of Ray's own error is a coloured traceback.
                future.set_exception(getattr(error, "cause", None) or error)

        # Pickled: a worker must enter the folder before it imports from there.
        call = self._ray.cloudpickle.dumps((function, args, kwargs))
        self._ray.remote(num_cpus=1)(_call).remote(self._files, call).future().add_done_callback(take)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which ends what is under way."""
        self._ray.shutdown()


def _call(files: tuple[str, Mapping[str, bytes]], call: bytes) -> Any:
    """Call a pickled function in a worker of a cluster."""
    from ray import cloudpickle

    if not _entered:
        _entered.append(enter_folder(*files))
    function, args, kwargs = cloudpickle.loads(call)
    return function(*args, **kwargs)


def collect_files(named: Any) -> Iterator[tuple[str, bytes]]:
    """Yield paths, absolute or relative to the current folder, and contents of files that calls elsewhere need.

    They are the files and the folders of policies that texts in the nested value `named` name, the images of maps, and
    the modules that this process has imported from the current folder.
    """
    here, paths = os.getcwd() + os.sep, []
    for text in set(re.findall(r'"([^"\\]+)"', json.dumps(named, default=str, ensure_ascii=False))):
        paths += [text, *glob.glob(f"{glob.escape(text)}/*.json"), *glob.glob(f"{glob.escape(text)}/*.safetensors")]
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            paths.append(os.path.join(os.path.dirname(text), read_mapping(text)["image"]))
    installed = sysconfig.get_path("stdlib"), sysconfig.get_path("purelib"), str(Path(__file__).parents[1])
    for module in list(sys.modules.values()):
        file = str(getattr(module, "__file__", ""))
        paths += [file.removeprefix(here)] if file.startswith(here) and not file.startswith(installed) else []
    for path in filter(os.path.isfile, paths):
        yield path, read_bytes(Path(path))


def enter_folder(folder: str, files: Mapping[str, bytes]) -> tempfile.TemporaryDirectory[str] | None:
    """Make `folder`, of another process or machine, the current one, if it holds the same `files`; else a copy of them.

    The copy is a temporary folder, which is returned. Raise a ValueError if this machine has no or another file of an
    absolute path.
    """
    copy = None
    there = {path: Path(folder, path) for path in files}
    wrong = [path for path, file in there.items() if not file.is_file() or read_bytes(file) != files[path]]
    for path in filter(os.path.isabs, wrong):
        raise ValueError(f"{platform.node()} has no or another {path}; relative paths work on every machine")
    sys.path[:] = [path for path in sys.path if path != folder]
    if wrong or not os.path.isdir(folder):
        copy = tempfile.TemporaryDirectory(prefix="lidarnaut_", ignore_cleanup_errors=True)
        os.makedirs(copy.name + folder)
        for path, content in files.items():
            file = Path(copy.name + os.path.normpath(os.path.join(folder, path)))
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        folder = copy.name + folder
    os.chdir(folder)
    sys.path.append(folder)
    return copy


def make_pool(num_workers: int | None, ray: str | None, named: Any = ()) -> Executor:
    """Return processes of this machine, None for as many as there are cores, or the Ray cluster of an address.

    `named` holds the names of files that calls on a cluster read, see `collect_files`.
    """
    if ray is not None:
        return RayExecutor(ray, named)
    # A fresh interpreter each: forked copies of a process that has threads (torch, numba) may hang.
    return ProcessPoolExecutor(num_workers, multiprocessing.get_context("spawn"), start_worker)


def stop(pool: Executor) -> None:
    """End what is under way in a pool."""
    if isinstance(pool, ProcessPoolExecutor):
        stop_workers(pool)
