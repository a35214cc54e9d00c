"""What an evaluation consists of."""

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
from lidarnaut.envs.slam import DEFAULT_SLAM
from lidarnaut.envs.worlds import BARN_NAMES, FAMILIES, WORLD_NAMES

USUAL = "usual"
"""Stands for what an environment takes if nothing is said; of robots, the one that a world is usually driven with."""
GROUPS = {"library": WORLD_NAMES, "families": tuple(FAMILIES), "barn": BARN_NAMES, "barn_test": BARN_NAMES[::6]}
"""Words that stand for many worlds; the benchmark BARN is reported on every sixth of its own.

:meta hide-value:
"""


def estimator_of(id: str) -> str:
    """Return the argument of an environment that names what estimates poses; empty where it has none."""
    return next((name for name in ("slam", "localizer") if name in arguments_of(id)), "")


@dataclass(frozen=True, slots=True)
class Case:
    """World, robot, physics and SLAM of an episode, as the environment takes them, or `usual`."""

    world: str
    robot: str
    physics: str
    slam: str
    """SLAM, or the localizer where the environment has one instead."""
    people: str = USUAL
    """How many people walk around, as `lidarnaut.envs.simulation.crowd.crowd_of` reads it."""
    label: str = ""
    """What the world is called in tables and files; empty if that is `world`."""
    id: str = EXPLORE
    """Of the environment."""
    arguments: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Further arguments of the environment, the same for all cases of an evaluation."""

    def name(self, part: str) -> str:
        """Return what `world`, `physics`, `slam` or `people` are called in tables and files; empty without one."""
        value, argument = getattr(self, part), estimator_of(self.id) if part == "slam" else part
        if part == "world" and self.label:
            return self.label
        usual = {**arguments_of(self.id), **self.arguments}.get(argument, "")
        if part == "people" and usual is None:
            usual = 0
        return value if value != USUAL else str(getattr(usual, "name", usual))

    def make_env(
        self, given: Mapping[str, Any] = MappingProxyType({}), needed: Mapping[str, Any] = MappingProxyType({})
    ) -> gymnasium.Env[Any, Any]:
        """Make the environment; procedural families draw from their test split.

        `given` holds worlds, robots and SLAMs of the user's own that names stand for, `needed` the arguments that the
        policy needs.
        """
        parts = {"world": self.world, "robot": self.robot, "physics": self.physics, "people": self.people}
        parts[estimator_of(self.id)] = self.slam
        own = {name: given.get(value, value) for name, value in parts.items() if name and value != USUAL}
        usual = {"split": "test"} if "split" in arguments_of(self.id) else {}
        return gymnasium.make(self.id, **{**usual, **self.arguments, **own, **needed}, disable_env_checker=True)


def parse_world(name: str) -> tuple[str, str]:
    """Return what a world is called, and which one it is, of `LABEL=WORLD`, or of a world without a label.

    Raises:
        ValueError: if a world of the library or a family has or lends the label.
    """
    if not (match := re.fullmatch(r"([\w.-]+)=(.+)", name)):
        return name, name
    label, world = match.groups()
    if {label, world} & {*WORLD_NAMES, *BARN_NAMES, *FAMILIES, *GROUPS}:
        raise ValueError(
            f"world {name!r}: only paths and module:attribute can have names of their own, as LABEL=PATH, and not "
            "those of the library or of a procedural family"
        )
    return label, world


Episodes = Annotated[int, Field(ge=1, le=100_000)]
"""Number of episodes of each policy in each world."""


class SlamAxis(Section):
    """The same explorers under several SLAMs: what mapping error costs them. Without worlds it is left out."""

    policies: tuple[str, ...] = ()
    worlds: tuple[str, ...] = ()
    episodes: Episodes = 5
    """Episodes of each explorer in each world under each SLAM."""
    slam: tuple[str, ...] = Field(default=("truth", "odometry", DEFAULT_SLAM), min_length=1)
    """SLAMs; `truth`, or else the first one, is what the others are compared with."""


class Settings(Section):
    """What an evaluation consists of. Every combination of robots, physics, SLAM and people is run in each world."""

    policies: tuple[str, ...] = Field(min_length=1)
    """Classic policies that can do the task by name, learned ones as `ppo:PATH` of a run folder, explorers and policies
    of your own as `module:attribute`; a name for tables goes before, as `LABEL=ppo:PATH`."""
    id: str = EXPLORE
    """Environment: an id of the package, or `module:id` of your own."""
    arguments: tyro.conf.Suppress[dict[str, Any]] = Field(default_factory=dict)
    """Further arguments of the environment, as `gymnasium.make` takes them; on the command line one by one, as
    `--arguments.goal_tolerance 0.2`."""
    worlds: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """Library worlds, procedural families (their test split), paths of world files or of ROS maps, `module:attribute`;
    `library`, `families` and `barn` stand for all of them, `barn_test` for every sixth of BARN's (`barn:12` is one),
    `usual` for the environment's own. A name for tables goes before the latter two, as `LABEL=PATH`."""
    episodes: Episodes = 10
    """Episodes of each policy in each world."""
    family_episodes: Episodes | None = None
    """Episodes in each procedural family, where each is another world; null takes `episodes`."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of the first episode, the next ones count up: same world, start and noise for every policy."""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--robot"])] = Field(default=(USUAL,), min_length=1)
    """Robots by name, path or `module:attribute`; `usual` takes each world's own."""
    physics: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """`bullet`, `kinematic`; `usual` takes the environment's own."""
    slam: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--localizer"])] = Field(default=(USUAL,), min_length=1)
    """`hector`, `tinyslam`, `gmapping`, `graph`, `odometry`, `truth`, or `module:attribute`; of an environment with a
    localizer, `amcl`, `odometry` or `truth`."""
    people: tuple[str, ...] = Field(default=(USUAL,), min_length=1)
    """How many people walk around: numbers, or crowds by name (`sparse`, `dense`, `corridor`, `doorway`, `crossing`),
    either with parameters, as `20?attentive=0.5,model=orca`; `usual` takes the environment's own, mostly nobody."""
    time_limit: PositiveFloat | None = None
    """Length of an episode [s]; null lets it grow with the world."""
    world_sections: bool = True
    """Whether the report has a section with curves, maps and tables for every world; with many it grows large."""
    slam_axis: SlamAxis = SlamAxis()
    """What mapping error costs."""

    @field_validator("people")
    @classmethod
    def _check_people(cls, people: tuple[str, ...]) -> tuple[str, ...]:
        if USUAL in people and len(people) > 1:
            raise ValueError("must not mix 'usual' with others; 0 stands for nobody")
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
            raise ValueError("must name none twice")
        return names

    @field_validator("slam_axis")
    @classmethod
    def _share_labels(cls, axis: SlamAxis, info: ValidationInfo) -> SlamAxis:
        labels: dict[str, str] = {}
        for label, world in map(parse_world, (*info.data.get("worlds", ()), *axis.worlds)):
            if labels.setdefault(label, world) != world:
                raise ValueError(f"worlds {labels[label]!r} and {world!r} must not both be called {label!r}")
        return axis

    @property
    def all_policies(self) -> tuple[str, ...]:
        """Policies of the evaluation and of its SLAM axis."""
        return tuple(dict.fromkeys((*self.policies, *self.slam_axis.policies)))

    def starts(self) -> Iterator[tuple[Case, int, tuple[str, ...]]]:
        """Yield every case and seed, and the policies that start there."""
        for case in self._cases(self.worlds, self.robots, self.physics, self.slam, self.people):
            episodes = (case.name("world") in FAMILIES and self.family_episodes) or self.episodes
            for seed in range(self.seed, self.seed + episodes):
                yield case, seed, self.policies

    def slam_axis_starts(self) -> Iterator[tuple[Case, int, tuple[str, ...]]]:
        """Yield the same for the SLAM axis; those of the evaluation may be among them."""
        axis = self.slam_axis
        for case in self._cases(axis.worlds, self.robots[:1], self.physics[:1], axis.slam, self.people[:1]):
            for seed in range(self.seed, self.seed + axis.episodes):
                yield case, seed, axis.policies

    def _cases(self, worlds: tuple[str, ...], *conditions: tuple[str, ...]) -> Iterator[Case]:
        arguments = self.arguments | ({} if self.time_limit is None else {"time_limit": self.time_limit})
        for name, robot, physics, slam, people in product(worlds, *conditions):
            label, world = parse_world(name)
            yield Case(world, robot, physics, slam, people, label if label != world else "", self.id, arguments)
