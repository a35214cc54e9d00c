"""Run explorers on the same places with the same seeds."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import cast

from benchmarks.arena.policies import parse_policy
from benchmarks.arena.records import Records, Row
from benchmarks.arena.settings import Settings
from benchmarks.arena.trace import trace_path
from benchmarks.arena.workers import Task, prepare, run_all


class Evaluation:
    """All episodes of some settings, in a folder that may hold a part of them already."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        """Make everything once, so that whatever is wrong comes out before any work.

        Args:
            settings: what to run.
            folder: takes `episodes.csv`, and a trace per episode.

        Raises:
            ValueError: if a name is wrong, or the folder holds another evaluation; says what is allowed.
            agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
        """
        self.settings = settings
        self.folder = folder
        self.policies = [parse_policy(name) for name in settings.policies]
        names = [policy.name for policy in self.policies]
        if len(set(names)) < len(names):
            raise ValueError(f"policies must not name one twice, got {', '.join(names)}")
        for world in settings.worlds:
            with contextlib.closing(settings.make_env(world)) as env:
                for policy in self.policies:
                    prepare(env, policy.make(), settings.seed)
        common = ("seed", "robot", "physics", "slam", "time_limit")
        self._records = Records(folder, {name: getattr(settings, name) for name in common})
        self._tasks = [
            # Pairs stay together, so that a part of an evaluation is a fair one.
            Task(settings, policy, world, seed, trace_path(folder, policy.name, world, seed))
            for world in settings.worlds
            for seed in range(settings.seed, settings.seed + settings.episodes)
            for policy in self.policies
        ]
        self._missing = [task for task in self._tasks if self._find(task) is None]

    @property
    def total(self) -> int:
        """Number of all episodes."""
        return len(self._tasks)

    @property
    def done(self) -> int:
        """Number of episodes that the folder holds."""
        return len(self._tasks) - len(self._missing)

    def run(self, jobs: int = 1, on_episode: Callable[[Row], None] | None = None) -> list[Row]:
        """Run the episodes that are missing, and return the rows of all.

        Args:
            jobs: processes to spread the episodes over; 1 stays in this one.
            on_episode: called with each new row.
        """
        if jobs < 1:
            raise ValueError(f"jobs must be at least 1, got {jobs}")
        for row in run_all(self._missing, jobs):
            self._records.add(row)
            if on_episode:
                on_episode(row)
        self._missing = []
        return [cast(Row, self._find(task)) for task in self._tasks]

    def _find(self, task: Task) -> Row | None:
        return self._records.find(task.policy, task.world, task.seed)
