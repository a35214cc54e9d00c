"""Settings of an evaluation."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from types import MappingProxyType
from typing import Annotated, Any

import gymnasium
import tyro
from pydantic import Field, PositiveFloat, ValidationInfo, field_validator

from lidarnaut.agents.config import Section
from lidarnaut.envs.ids import EXPLORE, arguments_of
from lidarnaut.envs.simulation.crowd import crowd_of
from lidarnaut.envs.worlds import BARN_NAMES, FAMILIES, WORLD_NAMES

USUAL = "usual"
"""Value of a setting that selects the environment's default; for robots, the default of each world."""
GROUPS = {"library": WORLD_NAMES, "families": tuple(FAMILIES), "barn": BARN_NAMES, "barn_test": BARN_NAMES[::6]}
"""Names of worlds by group; in settings, the name of a group stands for all its worlds. `barn_test` is every sixth BARN
world, as in the BARN benchmark.

:meta hide-value:"""


def estimator_of(id: str) -> str:
    """Return the name of the environment argument for the pose estimator: `slam`, `localizer`, or "" without either."""
    return next((name for name in ("slam", "localizer") if name in arguments_of(id)), "")


@dataclass(frozen=True, slots=True)
class Case:
    """Conditions of an episode: values of environment arguments, or `usual` for the environment's default."""

    world: str
    robot: str
    physics: str
    slam: str
    """Name of the SLAM algorithm, or of the localizer on a known map."""
    people: str = USUAL
    """Number of people, or name of a crowd preset."""
    label: str = ""
    id: str = EXPLORE
    arguments: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def name(self, part: str) -> str:
        """Return the displayed value of a condition; `part`: `world`, `physics`, `slam` or `people`."""
        value, argument = getattr(self, part), estimator_of(self.id) if part == "slam" else part
        if part == "world" and self.label:
            return self.label
        usual = {**arguments_of(self.id), **self.arguments}.get(argument, "")
        if part == "people" and usual is None:
            usual = 0
        return value if value != USUAL else str(getattr(usual, "name", usual))

    def make_env(
        self, custom: Mapping[str, Any] = MappingProxyType({}), needed: Mapping[str, Any] = MappingProxyType({})
    ) -> gymnasium.Env[Any, Any]:
        """Construct the environment, with procedural worlds from the test split.

        `custom` are user-defined worlds, robots and SLAMs by name; `needed` are arguments required by the policy.
        """
        parts = {"world": self.world, "robot": self.robot, "physics": self.physics, "people": self.people}
        parts[estimator_of(self.id)] = self.slam
        own = {name: custom.get(value, value) for name, value in parts.items() if name and value != USUAL}
        usual = {"split": "test"} if "split" in arguments_of(self.id) else {}
        return gymnasium.make(self.id, **{**usual, **self.arguments, **own, **needed}, disable_env_checker=True)


def parse_world(name: str) -> tuple[str, str]:
    """Split `LABEL=WORLD` into label and world. Without a label, both are the world.

    Raises:
        ValueError: if a labelled world or its label names a library world, family or group.
    """
    if not (match := re.fullmatch(r"([\w.-]+)=(.+)", name)):
        return name, name
    label, world = match.groups()
    if {label, world} & {*WORLD_NAMES, *BARN_NAMES, *FAMILIES, *GROUPS}:
        raise ValueError(
            f"world {name!r}: labels (LABEL=PATH) are for paths and module:attribute only, and must differ from "
            "library worlds and procedural families"
        )
    return label, world


Episodes = Annotated[int, Field(ge=1, le=100_000)]


class Settings(Section):
    """Settings of an evaluation. Policies run in each world with all combinations of robot, physics, SLAM, people."""

    policies: tuple[str, ...] = Field(min_length=1)
    """Names of classic policies, `ppo:PATH` of trained policies, or `module:attribute` of your code. `LABEL=ppo:PATH`
    sets the name in tables."""
    id: str = EXPLORE
    """Environment id; `module:id` for an environment of your own."""
    arguments: tyro.conf.Suppress[dict[str, Any]] = Field(default_factory=dict)
    """Further environment arguments; on the command line as `--arguments.goal_tolerance 0.2`."""
    worlds: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """Library worlds, procedural families (test split), paths of world files or ROS maps, `module:attribute`, or the
    groups `library`, `families`, `barn` and `barn_test` (every sixth BARN world). `barn:12` is a single world,
    `usual` the environment's default. `LABEL=PATH` sets the name in tables."""
    episodes: Episodes = 10
    """Number of episodes per policy and combination of conditions (world, robot, ...)."""
    family_episodes: Episodes | None = None
    """Number of episodes per policy and procedural family, each in a new world; null for the value of `episodes`."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of the first episode; each further episode adds 1. The seed sets world, start and noise."""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--robot"])] = Field(default=(USUAL,), min_length=1)
    """Robots by name, path or `module:attribute`; `usual` is the default of each world."""
    physics: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """Simulators: `bullet`, `kinematic`, or `usual` for the environment's default."""
    slam: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--localizer"])] = Field(default=(USUAL,), min_length=1)
    """SLAMs: `hector`, `tinyslam`, `gmapping`, `graph`, `odometry` or `truth`, also with parameters
    (`hector?preset=faithful`), or `module:attribute`. With a known map, localizers: `amcl`, `odometry` or `truth`.
    The report compares several with `truth`, if included."""
    people: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """Numbers of people, or presets (`sparse`, `dense`, `corridor`, `doorway`, `crossing`), optionally with parameters:
    `20?attentive=0.5,model=orca`; `usual` is the environment's default."""
    time_limit: PositiveFloat | None = None
    """Time limit of an episode [s]; null for a limit that grows with the world."""

    @field_validator("people")
    @classmethod
    def _check_people(cls, people: tuple[str, ...]) -> tuple[str, ...]:
        if USUAL in people and len(people) > 1:
            raise ValueError("must not mix 'usual' with other values; 0 means no people")
        for crowd in people:
            crowd_of(None if crowd == USUAL else crowd)
        return people

    @field_validator("policies", "worlds")
    @classmethod
    def _expand(cls, names: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        called: Sequence[str] = names
        if info.field_name == "worlds":
            names = tuple(one for name in names for one in GROUPS.get(name, (name,)))
            called = [parse_world(name)[0] for name in names]
        if len(set(called)) < len(called):
            raise ValueError("must be unique")
        return names

    def starts(self) -> Iterator[tuple[Case, int]]:
        """Yield conditions and seed of each start."""
        arguments = self.arguments | ({} if self.time_limit is None else {"time_limit": self.time_limit})
        conditions = self.robots, self.physics, self.slam, self.people
        for name, robot, physics, slam, people in product(self.worlds, *conditions):
            label, world = parse_world(name)
            case = Case(world, robot, physics, slam, people, label if label != world else "", self.id, arguments)
            episodes = (case.name("world") in FAMILIES and self.family_episodes) or self.episodes
            for seed in range(self.seed, self.seed + episodes):
                yield case, seed
