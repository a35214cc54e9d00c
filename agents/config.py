"""Configuration of an experiment."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, field_validator, model_validator

from lidarnaut.agents.frontiers.tasks import SIDES
from lidarnaut.envs.files import explain_unknown, parse_record

ALGORITHMS = {
    **dict.fromkeys(("PPO", "A2C", "SAC", "TD3", "DDPG", "DQN"), "stable_baselines3"),
    **dict.fromkeys(("TQC", "CrossQ", "QRDQN", "TRPO", "RecurrentPPO", "MaskablePPO"), "sb3_contrib"),
}
"""Algorithms by name, and the library of each."""


class Section(BaseModel):
    """Part of a configuration: immutable, and unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _take_one_for_several(cls, data: Any) -> Any:
        """Take a text where several are allowed: one alone, as command lines give it."""
        if not isinstance(data, dict):
            return data
        several = {name for name, one in cls.model_fields.items() if get_origin(one.annotation) is tuple}
        return {key: (value,) if key in several and isinstance(value, str) else value for key, value in data.items()}


Width = Annotated[int, Field(ge=1, le=8192)]
"""Width of a layer; more takes all memory before anything is learned."""
Count = Annotated[int, Field(ge=1, le=10**12)]
"""Number of steps or episodes."""
Side = Annotated[int, Field(ge=1, le=100_000)]
"""Number of what exists at the same time."""


class EnvironmentConfig(Section):
    """Where to learn: the id, how sub-environments run, and the environment's own arguments, which it checks."""

    model_config = ConfigDict(extra="allow")

    id: str = "lidarnaut/Explore-v0"
    """Environment; `module:id` imports the module that registers it first, also from the current folder."""
    vectorization: Literal["native", "sync", "async"] = "native"
    """How sub-environments run side by side: in the package's own vector environment, one after the other, or in a
    process each."""
    num_workers: int | None = Field(default=None, ge=0, le=100_000)
    """Processes of the native vector environment, 0 for none but this one; null takes as many as there are cores."""

    robots: tuple[str, ...] = ()
    """Robots to learn with, each in as many sub-environments, in place of one `robot`; evaluations take the first."""

    @property
    def arguments(self) -> dict[str, Any]:
        """The environment's own arguments; lists are tuples."""
        own = {name: _tuples(value) for name, value in (self.model_extra or {}).items()}
        return own | ({"robot": self.robots[0]} if self.robots else {})

    @property
    def each_robot(self) -> list["EnvironmentConfig"]:
        """The environment of each robot; this one where there is one robot."""
        return [self.model_copy(update={"robots": (name,)}) for name in self.robots] or [self]


class NetworkConfig(Section):
    """Network over the parts of an observation; see `lidarnaut.agents.networks`."""

    features: Width = 128
    """Width of the features that policy and value share."""
    channels: Width = 16
    """Features of a patch of a map crop."""
    hidden: Width = 64
    """Width of the hidden layer of the policy and of the value."""


class GaussianNetworkConfig(NetworkConfig):
    """Network whose actions are normally distributed: of algorithms on policy, where actions are twists."""

    log_std: float = Field(default=-0.5, ge=-20, le=20)
    """First logarithm of the actions' standard deviation, as a fraction of the robot's limits."""
    speed: float = Field(default=0.0, ge=-1, le=1)
    """First mean of the forward speed, as a fraction of the robot's limit: a robot at rest discovers little."""
    pursuit: float = Field(default=0.0, ge=0, le=1)
    """Weight in the mean of the twist that follows the first path of the observation `plan`; 0 leaves it out."""


class TrajectoryNetworkConfig(Section):
    """Network that chooses twists by PPO or A2C, where `trajectories` are seen; see `lidarnaut.agents.trajectories`."""

    width: Width = 32
    """Features of a twist."""
    hidden: Width = 64
    """Width of the hidden layers of the value."""


class DecisionNetworkConfig(Section):
    """Network that chooses frontiers by PPO or A2C; see `lidarnaut.agents.frontiers.network`."""

    width: Width = 64
    """Width of all layers."""
    heads: Width = 4
    """Heads of the attention between candidates; must divide `width`."""
    prior: float = Field(default=10.0, ge=0)
    """Weight of the prior in the logits: the larger, the less is explored at first; 0 leaves it out."""
    prior_policy: str = "rule"
    """What an untrained network chooses like: `rule` for `gain_over_cost`, or the folder of a score of frontiers, of a
    run of evolution or `pretrained/NAME`."""

    @model_validator(mode="after")
    def _divides(self) -> "DecisionNetworkConfig":
        if self.width % self.heads:
            raise ValueError(f"heads {self.heads} does not divide width {self.width}")
        return self


class EvaluationConfig(Section):
    """Episodes on worlds that training never sees (`split="test"`), the same ones each time."""

    every: Count = 25_000
    """Training steps between evaluations."""
    episodes: Side = 20
    """Episodes of an evaluation; episode i is seeded with i."""
    references: tuple[str, ...] = ("random",)
    """Classic policies, by name or as `module:attribute`, that are measured on the same episodes, once, before
    training. Where frontiers are chosen, they are rules and policies of decisions."""
    environment: dict[str, Any] = {}
    """Arguments that the environment of evaluations has in place of the training's, such as another `world`. Whoever
    runs the policy later sees the `observations` of evaluations, too."""

    @property
    def arguments(self) -> dict[str, Any]:
        """The same; lists are tuples."""
        return {name: _tuples(value) for name, value in self.environment.items()}


class CheckpointConfig(Section):
    """When the state of the training is saved."""

    every: Count = 20_000
    """Training steps between checkpoints, at most: what a kill can cost. Not less than an update takes."""
    keep: int = Field(default=3, ge=2)
    """Newest checkpoints that are kept."""


class EvolutionConfig(Section):
    """Evolution of a frontier score by CMA-ES; see `lidarnaut.agents.frontiers.evolution`."""

    algorithm: Literal["evolution"]
    """Tells this configuration from others."""
    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Name, the first part of the run folder's."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of everything."""
    generations: Count = 100
    """Generations to train for."""
    population: int = Field(default=14, ge=4, le=100_000)
    """Individuals of a generation."""
    tasks: Side = 24
    """Episodes that every individual of a generation explores."""
    sigma: PositiveFloat = 0.06
    """First standard deviation of every weight, times the spread of its feature."""
    families: tuple[str, ...] = ("rooms", "maze", "warehouse", "caves")
    """Procedural families of the training worlds."""
    validation_tasks: Side = 240
    """Episodes, the same ones each time, on which the policy is measured; they select nothing."""
    validate_every: Count = 10
    """Generations between two validations."""
    num_workers: Side | None = None
    """Processes; null takes as many as there are cores."""

    @field_validator("families")
    @classmethod
    def _know_families(cls, families: tuple[str, ...]) -> tuple[str, ...]:
        if unknown := [name for name in families if name not in SIDES]:
            raise ValueError(f"unknown family {explain_unknown(unknown[0], SIDES)}")
        return families


class TrainingConfig(Section):
    """An experiment."""

    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Name, the first part of the run folder's."""
    total_steps: Count
    """Environment steps to train for, all environments together; rounded up to whole updates."""
    algorithm: str
    """Class of stable-baselines3 or sb3-contrib by name, or `module:attribute` of one that is derived from theirs."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of everything."""
    num_envs: Side = 16
    """Environments that run side by side."""
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Where torch computes: `auto` takes a GPU if there is one. Networks this small gain nothing on a GPU."""
    torch_threads: Side = 1
    """Threads of torch. More than one slows small networks down."""
    environment: EnvironmentConfig = EnvironmentConfig()
    """Where to learn."""
    hyperparameters: dict[str, Any] = {}
    """Arguments of the algorithm's class; `lin_3e-4` falls linearly to zero, `action_noise: 0.1` is Gaussian."""
    network: dict[str, Any] = {}
    """What the network is like: the keys of `NetworkConfig` and `GaussianNetworkConfig`, or of
    `DecisionNetworkConfig`."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """How progress is measured."""
    checkpoints: CheckpointConfig = CheckpointConfig()
    """When the state is saved."""

    @field_validator("algorithm")
    @classmethod
    def _know_algorithm(cls, algorithm: str) -> str:
        if ":" not in algorithm and algorithm not in ALGORITHMS:
            known = [*ALGORITHMS, "evolution"]
            raise ValueError(f"unknown algorithm {explain_unknown(algorithm, known)}, and module:attribute of your own")
        return algorithm


def parse_config(data: Mapping[str, Any], source: str) -> TrainingConfig | EvolutionConfig:
    """Return the configuration that nested mappings which come from `source` describe, of either kind.

    Raises:
        ValueError: keys or values do not fit; names `source` and the keys, a line for each.
    """
    kind: Any = EvolutionConfig if data.get("algorithm") == "evolution" else TrainingConfig
    return parse_record(data, source, kind)


CONFIGURATIONS = Path(__file__).resolve().parents[1] / "configs"
"""Folder of the packaged configurations."""


def find_configuration(name: str) -> Path:
    """Return the file of a configuration: a path, or the name of a packaged one, such as `explore_frontiers`.

    Raises:
        ValueError: if there is no such configuration; the message lists the packaged ones.
    """
    if name.endswith((".yaml", ".yml")) or Path(name).is_file():
        return Path(name)
    known = {path.stem: path for path in sorted(CONFIGURATIONS.rglob("*.yaml"))}
    if name not in known:
        raise ValueError(f"unknown configuration {explain_unknown(name, known)}, and paths of YAML files")
    return known[name]


def change(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings with other values at keys such as `a.b`; ValueError if one leads through no mapping."""
    changed: dict[str, Any] = copy.deepcopy(dict(data))
    for key, value in changes.items():
        *parents, name = key.split(".")
        section = changed
        for parent in parents:
            section[parent] = {} if section.get(parent) is None else section[parent]
            section = section[parent]
            if not isinstance(section, dict):
                raise ValueError(f"--{key}: {parent} is {section!r}, and holds no keys")
        section[name] = value
    return changed


def _tuples(value: Any) -> Any:
    """Return a value with tuples in place of lists, as environments take them."""
    if isinstance(value, dict):
        return {key: _tuples(one) for key, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
