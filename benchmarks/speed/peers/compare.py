"""Comparison with other simulators of lidar robots: `python -m lidarnaut.benchmarks.speed --only peers`."""

import functools
import json
import math
import os
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from lidarnaut.envs.progress import Progress

PEERS, STEP = (Path(__file__).with_name(name) for name in ("peers.yaml", "step.py"))
HOME = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "lidarnaut" / "peers"
"""Folder of the virtual environments."""
SETTINGS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
SETTINGS |= {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "JAX_PLATFORMS": "cpu", "MPLBACKEND": "Agg"}
SETTINGS |= {"PYTHONPATH": os.pathsep.join(sys.path)}  # ignored by `python -I`


def run(*command: str | Path) -> str:
    """Return the output of a command; raise ValueError with the last line of its messages if it fails."""
    done = subprocess.run(command, env=os.environ | SETTINGS, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode:
        messages = (done.stdout + done.stderr).strip() or f"exit status {done.returncode}"
        raise ValueError(messages.splitlines()[-1])
    return done.stdout


@functools.cache
def install(name: str, *packages: str) -> tuple[str | Path, ...]:
    """Return the Python command of a peer, after the installation of its packages in its virtual environment."""
    if not packages:
        return (sys.executable,)
    python, torch = HOME / name / "bin" / "python", version("torch").partition("+")[0]
    if not python.with_name("pip").exists():
        run(sys.executable, "-m", "venv", HOME / name)
    pinned = [package.format(torch=torch) for package in packages]
    run(python, "-I", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *pinned)
    return python, "-I"


def compare(peers: Mapping[str, Any], seconds: float, rounds: int) -> list[dict[str, Any]]:
    """Return median steps per second of `peers` (`peers.yaml`), run in turn by `STEP`, and ratios to the first."""
    speeds: dict[tuple[int, int, str], list[float]] = {}
    failed: dict[str, str] = {}
    for name, peer in Progress([*peers.items()] * rounds, desc="peers", unit="run"):
        if name in failed:
            continue
        try:
            output = run(*install(name, *peer.get("packages", ())), STEP, name, str(seconds), *peer["cases"])
        except (OSError, ValueError) as error:
            failed[name] = str(error)
            continue
        for case in map(json.loads, output.splitlines()):
            speed = case["steps"] / case["seconds"]
            speeds.setdefault((case["num_envs"], case["people"], name), []).append(speed)
    rows = []
    for (num_envs, people, name), values in sorted(speeds.items(), key=lambda item: item[0][:2]):
        ratios = [a / b for a, b in zip(values, speeds.get((num_envs, people, next(iter(peers))), []))]
        row = {"simulator": name, "sub-environments": num_envs, "people": people, "steps/s": round(median(values))}
        rows.append({**row, "ratio": median(ratios or [math.nan]), "simulates": peers[name]["simulates"]})
    return rows + [{"simulator": name, "simulates": f"skipped: {reason}"} for name, reason in failed.items()]
