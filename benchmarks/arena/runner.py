"""Evaluation of policies in the same worlds with the same seeds."""

import contextlib
import json
import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gymnasium import spaces

from lidarnaut.agents.policy_names import Makers, PolicySource, is_bound, parse_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.trust import named_code
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import prepare
from lidarnaut.baselines.policy import marked
from lidarnaut.benchmarks.arena.conditions import Conditions, arguments_text, describe
from lidarnaut.benchmarks.arena.evaluation_folder import Key, Records, Row, columns_of
from lidarnaut.benchmarks.arena.measures import Measures
from lidarnaut.benchmarks.arena.settings import USUAL, Case, Settings
from lidarnaut.benchmarks.arena.trace import episode_name, recording_path, trace_path
from lidarnaut.benchmarks.arena.workers import FAULTS, NOT_RUN, Job, Result, explain_fault, run_all
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import Lock, own_folder, split_parameters, write_file
from lidarnaut.envs.ids import CHOOSE
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot
from lidarnaut.envs.worlds import BARN_NAMES, FAMILIES, WORLD_NAMES


@contextlib.contextmanager
def _blaming(culprit: str) -> Iterator[None]:
    try:
        yield
    except (ValueError, RuntimeError, ImportError, OSError):
        raise
    except FAULTS as error:
        raise ValueError(f"{culprit}: {explain_fault(error)}") from error


def _parse_shard(shard: str | None) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", "1/1" if shard is None else shard)
    number, total = map(int, match.groups()) if match else (0, 0)
    if not 1 <= number <= total:
        raise ValueError(f"shard must be I/N with I from 1 to N, such as 2/4, got {shard!r}")
    return number, total


class Evaluation:
    """Evaluation of policies with results in a folder. An incomplete evaluation in the folder is resumed."""

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        shard: str | None = None,
        custom: Mapping[str, Any] | None = None,
        trust: Iterable[str] = (),
    ) -> None:
        """Create or resume an evaluation, after constructing every environment and policy once as a check.

        Args:
            settings: policies, worlds, conditions and numbers of episodes.
            folder: output folder.
            shard: part that `run` executes, such as `2/4` (every fourth start); None for all.
            custom: user-defined policies, worlds, robots and SLAMs by name; picklable for several processes.
            trust: modules and names that checkpoints may import; see `lidarnaut.agents.trust`.

        Raises:
            ValueError: if a name is unknown, a robot does not fit, or the folder holds another evaluation.
            lidarnaut.agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
        """
        number, total = _parse_shard(shard)
        self.settings, self.folder = settings, folder
        trust = {*trust, *named_code(settings.model_dump())}
        self._shard = f"{number}of{total}" if total > 1 else ""
        self._custom = dict(custom or {})
        self._robots: dict[Case, str] = {}
        self._facts: dict[str, str] = {}
        classic = self._check_cases()
        self._policies = {}
        for name in settings.policies:
            with _blaming(name):
                self._policies[name] = self._marked(parse_policy(name, classic, self._custom, trust))
        names = [policy.name for policy in self._policies.values()]
        if len(set(names)) < len(names):
            raise ValueError(f"policies must be unique, got {', '.join(names)}")
        self._tasks = self._lay_out()
        self._check_fit()
        # Paired episodes stay in one shard.
        groups = {start: k for k, start in enumerate(dict.fromkeys((key.world, key.seed) for key in self._tasks))}
        own = [task for key, task in self._tasks.items() if groups[key.world, key.seed] % total == number - 1]
        common = {"time_limit": settings.time_limit, "id": settings.id}
        common["arguments"] = json.loads(json.dumps(settings.arguments, default=repr))
        self._records = Records(folder, self.columns, common, self._shard, self._own_files())
        self._missing = self._not_found(own)
        self.total = len(own)
        self.conditions = Conditions(
            task={"progress": self.measures.progress, "success": self.measures.success},
            measures=list(self.measures.own),
            settings=settings.model_dump(mode="json", fallback=repr),
            facts=self._facts,
            policies={one.name: arguments_text(one.arguments) for one in self._policies.values()},
        )

    @property
    def done(self) -> int:
        return self.total - len(self._missing)

    def run(
        self,
        jobs: int = 1,
        on_result: Callable[[Result], None] = lambda _: None,
        bags: Path | None = None,
        record: bool = False,
    ) -> list[Result]:
        """Run the episodes without a result, and return the failed episodes.

        Args:
            jobs: number of processes.
            on_result: called after each episode, also after a failure.
            bags: output folder for ROS 2 bags of the episodes; None for none.
            record: whether to record the episodes for replay in a browser.

        Raises:
            ValueError: if an argument is invalid, or the folder has a different number of shards.
            lidarnaut.envs.files.LockedError: if another process runs this evaluation or shard.
        """
        if jobs < 1:
            raise ValueError(f"jobs must be at least 1, got {jobs}")
        failures = []
        with contextlib.ExitStack() as locks:
            # Shards may run at the same time, but not with a full run.
            locks.enter_context(Lock(self.folder, shared=bool(self._shard)))
            if self._shard:
                locks.enter_context(Lock(self.folder, f"lock-{self._shard}"))
            self._records.begin()
            self.conditions.save(self.folder)
            self._missing = self._not_found(self._missing)
            is_logged = logging.getLogger("lidarnaut").isEnabledFor(logging.INFO)
            tasks = [replace(task, has_recording=record, is_logged=is_logged) for task in self._missing]
            if bags:
                own_folder(bags)
                tasks = [replace(task, bag=bags / f"{episode_name(task.key._asdict())}.mcap") for task in tasks]
            for result in run_all(tasks, jobs):
                if result.row is None:
                    self._records.add_failure(result.key, result.reason)
                    failures.append(result)
                else:
                    for where, content in ((trace_path, result.trace), (recording_path, result.recording)):
                        if content:
                            path = where(self.folder, result.row)
                            own_folder(self.folder, path.parent.name)
                            write_file(path, content)
                    self._records.add(result.row)
                on_result(result)
            self._missing = self._not_found(self._missing)
        return failures

    def rows(self) -> list[Row]:
        """Return the rows of `episodes.csv` for finished episodes of all machines."""
        return list(filter(None, map(self._find, self._tasks.values())))

    def missing(self) -> list[Result]:
        """Return the failed and pending episodes of all machines, with reasons."""
        missing = self._not_found(self._tasks.values())
        return [Result(task.key, reason=self._records.failure(task.key) or NOT_RUN) for task in missing]

    def _own_files(self) -> dict[str, str]:
        """Return the sources of user-defined worlds, and files of SLAM presets and robots, as `Records` takes them."""
        worlds = {key.world: task.case.world for key, task in self._tasks.items()}
        known = {USUAL, *WORLD_NAMES, *BARN_NAMES, *FAMILIES}
        presets = {key.slam: split_parameters(key.slam)[1].get("preset", "") for key in self._tasks}
        robots = {f"robot {key.robot}": task.case.robot for key, task in self._tasks.items()}
        files = {name: file for name, file in (presets | robots).items() if Path(str(file)).is_file()}
        return {name: world for name, world in worlds.items() if world not in known} | files

    def _find(self, task: Job) -> Row | None:
        return self._records.find(task.key, task.policy.model)

    def _not_found(self, tasks: Iterable[Job]) -> list[Job]:
        return [task for task in tasks if self._find(task) is None]

    def _check_cases(self) -> Makers:
        classic: Makers | None = None
        faults: list[BaseException] = []
        robots = {name: (name, load_robot(name)) for name in ROBOT_NAMES}
        for case, seed in self.settings.starts():
            if case in self._robots:
                continue
            with _blaming(f"{case.slam} in {case.name('world')}"):
                env = case.make_env(self._objects(case))
            with contextlib.closing(env):
                inner = lidar_env_of(env)
                self._robots[case] = name = inner.robot_params.name
                first, robot = robots.setdefault(name, (case.robot, inner.robot_params))
                if robot != inner.robot_params:
                    raise ValueError(
                        f"robots {first!r} and {case.robot!r} differ, but both have the name {name!r}, which "
                        "identifies their episodes; change `name` in one of them"
                    )
                self.measures = Measures(inner.task.measures, inner.task.progress, inner.task.success_condition)
                self._facts |= describe(inner, case.name("people"), case.name("slam"))
                try:
                    if classic is None:
                        env.reset(seed=seed)
                        classic = policies_for(env)
                        self._chooses = isinstance(env.action_space, spaces.Discrete)
                        self._explores = inner.task.coverage is not None and len(inner.robots) == 1
                except FAULTS as error:  # reported again by the episodes
                    faults.append(error)
        if classic is None:
            with _blaming(self.settings.id):
                raise faults[0]
        self.columns = columns_of(self.measures)
        return classic

    def _marked(self, policy: PolicySource) -> PolicySource:
        if not policy.observes or is_bound(policy.name):
            return policy
        case = replace(next(iter(self._robots)), id=self._id_for(policy))
        with contextlib.closing(case.make_env(self._objects(case), policy.arguments)) as env:
            return replace(policy, name=marked(policy.name, None, env))

    def _objects(self, case: Case) -> dict[str, Any]:
        return {name: self._custom[name] for name in (case.world, case.robot, case.slam) if name in self._custom}

    def _lay_out(self) -> dict[Key, Job]:
        tasks: dict[Key, Job] = {}
        for case, seed in self.settings.starts():
            for policy in self._policies.values():
                conditions = self._robots[case], case.name("physics"), case.name("slam"), case.name("people")
                key = Key(policy.name, case.name("world"), seed, *conditions)
                # Upper bounds use the true pose under every SLAM.
                is_oracle = is_bound(policy.name) and not policy.observes
                own = replace(case, id=self._id_for(policy), slam="truth" if is_oracle else case.slam)
                tasks.setdefault(key, Job(key, policy, own, self._objects(own)))
        return tasks

    def _id_for(self, policy: PolicySource) -> str:
        id = self.settings.id
        if policy.level is None or (policy.level == "decision") == self._chooses:
            return id
        if policy.level == "decision" and self._explores:
            return CHOOSE
        wanted = "frontiers" if self._chooses else "twists"
        raise ValueError(f"{policy.name} outputs {policy.level}s, but {id} takes {wanted}")

    def _check_fit(self) -> None:
        groups: dict[tuple[Any, ...], dict[str, Job]] = {}
        for task in self._tasks.values():
            groups.setdefault(task.conditions, {}).setdefault(task.policy.name, task)
        pending = {task.policy.name for task in self._tasks.values()}
        faults: list[Exception] = []
        for group in groups.values():
            here = [task for name, task in group.items() if name in pending]
            if not here:
                continue
            with contextlib.closing(here[0].make_env()) as env:
                for task in here:
                    try:
                        prepare(env, task.policy.make(env.action_space), task.key.seed, steps=1)
                        pending.discard(task.policy.name)
                    except (ValueError, CheckpointError) as error:
                        faults.append(error)
                    except FAULTS as error:
                        faults.append(ValueError(f"{task.policy.name}: {explain_fault(error)}"))
        if pending and faults:
            raise faults[0]
