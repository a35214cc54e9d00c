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

    RefusedError if it fails, or takes longer than `timeout` [s]; SkippedError if the machine is too busy for Ray.
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
    """Install the pinned packages of an environment and return its folder; SkippedError if one of them cannot be."""
    folder, marker, pins = FOLDER / name, FOLDER / name / "pins.txt", "\n".join(PINS[name])
    if marker.is_file() and marker.read_text() == pins:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f"installing {name}: {', '.join(PINS[name])}", file=sys.stderr)
    try:
        _install(name, folder)
    except (RefusedError, OSError) as error:
        raise SkippedError(f"cannot be installed: {error}") from error
    marker.write_text(pins)
    return folder


def _install(name: str, folder: Path) -> None:
    if name == "npm":
        (folder / "package.json").write_text('{"private": true, "type": "module"}')
        call(["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--save-exact", *PINS[name]], cwd=folder)
    elif name == "debian":  # unpacked into a folder: nothing is installed on the machine, and no rights are needed
        call(["/usr/bin/python3", "--version"])
        call(["apt-get", "download", *PINS[name]], cwd=folder)
        for package in folder.glob("*.deb"):
            call(["dpkg", "--extract", package, folder])
    else:
        call([sys.executable, "-m", "venv", folder])
        pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-compile"]
        call([*pip, *PINS[name]], 3 * TIMEOUT, cwd=ROOT)


def run(environment: str, client: str, function: str, *arguments: Any, **given: Any) -> Any:
    """Run a client's function; return the JSON of its last line. RefusedError if it fails, SkippedError as `make`."""
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
