"""Measurement of non-learned policies in worker processes during a training."""

import contextlib
import functools
import hashlib
import json
import logging
import os
from concurrent.futures import Future
from pathlib import Path

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.curves import TEST, Row
from lidarnaut.agents.evaluation import Evaluator, evaluation_environment
from lidarnaut.agents.pools import collect_files, make_pool
from lidarnaut.agents.trust import REGISTERED, named_code
from lidarnaut.baselines import ALL
from lidarnaut.envs.files import read_bytes, read_json, write_file
from lidarnaut.envs.ids import find_spec
from lidarnaut.envs.processes import interrupts_held
from lidarnaut.envs.progress import Progress

LOGGER = logging.getLogger(__name__)
Values = list[dict[str, float]]
"""Measures by name of the test episodes 0, 1, ..."""
_PACKAGE = Path(__file__).resolve().parents[1]
_measured_by: list[tuple[TrainingConfig, Evaluator]] = []


class References:
    """Measurement of the reference policies of a training in its test episodes.

    Results of policies, robots and worlds of the package are cached in `~/.cache/lidarnaut/references`. `held` stops
    the workers.
    """

    def __init__(
        self, config: TrainingConfig, evaluator: Evaluator, held: contextlib.ExitStack, *, progress: bool = True
    ) -> None:
        self._config, self._evaluator, self._held, self._progress = config, evaluator, held, progress
        for name in config.evaluation.references:
            evaluator.make_reference(name)  # Unknown names are found before the first step.
        self._names = {name: evaluator.mark(name) for name in config.evaluation.references}
        self._caches = {name: _cache_file(config, name) for name in self._names}
        self._values: dict[str, Values] = {}
        self._episodes: dict[str, list[Future]] = {}

    def start(self) -> None:
        """Start the workers for the episodes that are not cached; no effect after the first call."""
        if self._values:
            return
        count = self._config.evaluation.num_tests
        columns = ["progress", *(measure.name for measure in self._evaluator.measures)]
        self._values = {name: _read(path, columns)[:count] for name, path in self._caches.items()}
        missing = sum(count - len(values) for values in self._values.values())
        if missing:
            bar = Progress(total=missing, desc="references", unit="episode", leave=False, disable=not self._progress)
            self._held.enter_context(bar)
            pool = self._held.enter_context(make_pool(max(1, (os.cpu_count() or 1) // 2), None))
            with interrupts_held():
                for name, values in self._values.items():
                    seeds = range(len(values), count)
                    self._episodes[name] = [pool.submit(_measure, self._config, name, seed) for seed in seeds]
            for episode in (one for some in self._episodes.values() for one in some):
                episode.add_done_callback(lambda _: bar.update())

    def rows(self, *, wait: bool = False) -> list[Row]:
        """Return rows of the evaluation table in the order of the configuration, at first of finished policies only."""
        rows = list[Row]()
        for name, marked in self._names.items() if self._values else ():
            if wait or all(episode.done() for episode in self._episodes.get(name, ())):
                row = self._evaluator.summarise(marked, TEST, self._collect(name))
                rows.append({"policy": marked, "split": TEST, "steps": 0, **row})
        return rows

    def _collect(self, name: str) -> Values:
        values = self._values[name]
        for episode in self._episodes.pop(name, ()):
            error = None if episode.cancel() else episode.exception()  # episodes that wait run in this process
            if error is not None:  # such as objects of the main script, which workers cannot import
                LOGGER.info("%s is measured in this process: %s: %s", name, type(error).__name__, error)
            is_here = episode.cancelled() or error is not None
            values.append(self._evaluator.reference(name, len(values)) if is_here else episode.result())
            path = self._caches[name]
            if path is not None and len(values) == self._config.evaluation.num_tests:
                with contextlib.suppress(OSError):
                    path.parent.mkdir(parents=True, exist_ok=True)
                    write_file(path, json.dumps({"episodes": values}))
        return values


def _measure(config: TrainingConfig, name: str, seed: int) -> dict[str, float]:
    if not _measured_by or _measured_by[0][0] != config:
        if hasattr(os, "nice"):
            os.nice(10)
        _measured_by[:] = [(config, Evaluator(config))]
    return _measured_by[0][1].reference(name, seed)


def _read(path: Path | None, columns: list[str]) -> Values:
    """Return cached episodes; none if the file is missing or damaged."""
    try:
        episodes = read_json(path)["episodes"] if path else []
        return [{name: float(one[name]) for name in columns} for one in episodes]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _cache_file(config: TrainingConfig, name: str) -> Path | None:
    """Return the cache file of a reference policy; None if code or objects of the user have an effect."""
    environment = evaluation_environment(config).model_dump(exclude={"num_workers", "vectorization"})
    id = environment["id"].removeprefix("lidarnaut:")
    if name not in ALL or not id.startswith("lidarnaut/") or named_code(environment).keys() - REGISTERED:
        return None
    named = (one for one in collect_files(environment) if not one[0].endswith(".py"))
    files = sorted((path, hashlib.sha256(content).hexdigest()) for path, content in named)
    known = [name, environment, find_spec(id).kwargs, files, _code_version()]
    try:
        key = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    except TypeError:
        return None
    return _cache_folder() / f"{key[:32]}.json"


def _cache_folder() -> Path:
    home = os.environ.get("XDG_CACHE_HOME", "")
    home = home if os.path.isabs(home) else os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home, "lidarnaut", "references")


@functools.cache
def _code_version() -> str:
    """Return a hash of the code and data that episodes of non-learned policies depend on."""
    files = [_PACKAGE / "agents" / name for name in ("robots.py", "evaluation.py", "frontiers/tasks.py")]
    for folder in ("envs", "baselines"):
        files += sorted(path for path in (_PACKAGE / folder).rglob("*.*") if path.suffix in (".py", ".yaml"))
    return hashlib.sha256(b"".join(map(read_bytes, files))).hexdigest()
