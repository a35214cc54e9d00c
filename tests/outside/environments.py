"""Public packages at pinned versions, each group in an environment of its own, made when a check first needs it."""

import functools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CLIENTS = Path(__file__).resolve().parent / "clients"
FOLDER = ROOT / ".venv-outside"
PINS: dict[str, tuple[str, ...]] = json.loads((CLIENTS.parent / "pins.json").read_text())
"""Pinned packages by environment: of PyPI, or of npm (`npm`) or Debian (`debian`)."""
TIMEOUT = 600
"""Maximum duration of a client [s]."""


class SkippedError(Exception):
    """A tool is not available on this machine; the message is the reason."""


class RefusedError(Exception):
    """A client ended with an error; the message is its last line."""


def call(command: list[Any], timeout: float = TIMEOUT, **options: Any) -> str:
    """Run a command and return its output.

    Raises:
        RefusedError: it failed, or took longer than `timeout` [s].
        SkippedError: the machine is too busy for Ray.
    """
    try:
        done = subprocess.run([str(one) for one in command], capture_output=True, text=True, timeout=timeout, **options)
    except subprocess.TimeoutExpired as error:
        raise RefusedError(f"takes longer than {timeout:g} s") from error
    if done.returncode:
        lines = (done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}").splitlines()
        if "timed out during startup" in done.stdout:
            raise SkippedError("Ray does not start within its 30 s on this busy machine")
        errors = [line.strip() for line in lines if "rror" in line and not line.startswith(" ")]
        raise RefusedError((errors or lines)[-1][:300])
    return done.stdout


@functools.cache
def make(name: str) -> Path:
    """Install the pinned packages of an environment and return its folder.

    Raises:
        SkippedError: a package cannot be installed.
    """
    folder, pins = FOLDER / name, "\n".join(PINS[name])
    marker = folder / "pins.txt"
    if marker.is_file() and marker.read_text() == pins:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f"installing {name}: {', '.join(PINS[name])}", file=sys.stderr)
    try:
        {"npm": _install_npm, "debian": _install_debian}.get(name, _install_python)(folder, PINS[name])
    except (RefusedError, OSError) as error:
        raise SkippedError(f"cannot be installed: {error}") from error
    marker.write_text(pins)
    return folder


def _install_python(folder: Path, pins: tuple[str, ...]) -> None:
    call([sys.executable, "-m", "venv", folder])
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-compile"]
    call([*pip, *pins], 3 * TIMEOUT, cwd=ROOT)


def _install_npm(folder: Path, pins: tuple[str, ...]) -> None:
    if not shutil.which("npm"):
        raise RefusedError("there is no npm")
    (folder / "package.json").write_text('{"private": true, "type": "module"}')
    call(["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--save-exact", *pins], cwd=folder)


def _install_debian(folder: Path, pins: tuple[str, ...]) -> None:
    """Unpack packages into a folder: nothing is installed on the machine, and no rights are needed."""
    if not shutil.which("apt-get") or not Path("/usr/bin/python3").exists():
        raise RefusedError("this machine is not a Debian with /usr/bin/python3")
    call(["apt-get", "download", *pins], cwd=folder)
    for package in folder.glob("*.deb"):
        call(["dpkg", "--extract", package, folder])


def run(environment: str, client: str, function: str, *arguments: Any, **given: Any) -> Any:
    """Run a function of a client; return the JSON of its last line.

    Raises:
        SkippedError: the environment cannot be made.
        RefusedError: the client fails.
    """
    folder, variables = make(environment), os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": "", "HOME": str(FOLDER)}
    command = [folder / "bin" / "python", CLIENTS / "client.py", client]
    if environment == "npm":
        shutil.copy(CLIENTS / f"{client}.mjs", folder)  # modules are looked for beside the script
        command = ["node", folder / f"{client}.mjs"]
    elif environment == "debian":
        packages = folder / "usr" / "lib" / "python3" / "dist-packages"
        libraries = next((folder / "usr" / "lib").glob("*-linux-gnu*"))
        found = (libraries, libraries / "blas", libraries / "lapack")
        variables |= {"PYTHONPATH": str(packages), "LD_LIBRARY_PATH": ":".join(map(str, found))}
        command[0] = "/usr/bin/python3"
    output = call([*command, function, *arguments], input=json.dumps(given), env=variables)
    # Some libraries print at exit.
    return json.loads(next((line for line in reversed(output.splitlines()) if line.startswith(("{", "["))), "null"))


def versioned(environment: str, package: str) -> str:
    """Return a package of an environment with its pinned version."""
    pin = next(pin for pin in PINS[environment] if pin.startswith((f"{package}=", f"{package}@", f"{package}[")))
    return f"{package} {pin.rpartition('@' if environment == 'npm' else '=')[2]}"
