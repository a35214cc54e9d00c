"""Configuration of experiments."""

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
"""Library of each algorithm, by algorithm name."""


class Section(BaseModel):
    """Immutable configuration section; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _take_one_for_several(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        several = {name for name, one in cls.model_fields.items() if get_origin(one.annotation) is tuple}
        return {key: (value,) if key in several and isinstance(value, str) else value for key, value in data.items()}


Width = Annotated[int, Field(ge=1, le=8192)]
"""Layer width; the limit bounds memory."""
Count = Annotated[int, Field(ge=1, le=10**12)]
"""Number of steps, episodes or generations."""
Side = Annotated[int, Field(ge=1, le=100_000)]
"""Number of parallel environments, episodes or threads."""


class EnvironmentConfig(Section):
    """Environment id, execution of sub-environments, and arguments of the environment."""

    model_config = ConfigDict(extra="allow")

    id: str = "lidarnaut/Explore-v0"
    """Gymnasium id; `module:id` imports the module first."""
    vectorization: Literal["native", "sync", "async"] = "native"
    """Execution of sub-environments: by the package's vector environment, sequential, or in one process each."""
    num_workers: int | None = Field(default=None, ge=0, le=100_000)
    """Worker processes of `native` execution; 0 uses the main process, null one worker per core."""

    robots: tuple[str, ...] = ()
    """Training robots, instead of one `robot`, in equal shares of the sub-environments. Evaluations use the first."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of the environment, with lists as tuples."""
        own = {name: _tuples(value) for name, value in (self.model_extra or {}).items()}
        return own | ({"robot": self.robots[0]} if self.robots else {})

    @property
    def each_robot(self) -> list["EnvironmentConfig"]:
        """Configuration for each training robot."""
        return [self.model_copy(update={"robots": (name,)}) for name in self.robots] or [self]


class NetworkConfig(Section):
    """Network with one encoder per observation part; see `lidarnaut.agents.networks`."""

    features: Width = 128
    """Width of the features shared by policy and value function."""
    channels: Width = 16
    """Output channels of the convolution over map patches."""
    hidden: Width = 64
    """Width of the hidden layers of policy and value function."""


class GaussianNetworkConfig(NetworkConfig):
    """Network with Gaussian twists, for on-policy algorithms."""

    log_std: float = Field(default=-0.5, ge=-20, le=20)
    """Initial logarithm of the standard deviation of actions, as a fraction of the robot's limits."""
    speed: float = Field(default=0.0, ge=-1, le=1)
    """Initial mean forward speed, as a fraction of the robot's limit; speed helps early exploration."""
    plan_prior: float = Field(default=0.0, ge=0, le=1)
    """Weight of path pursuit in the mean action, for observation `plan`; 0 disables pursuit."""


class TrajectoryNetworkConfig(Section):
    """Network that selects a twist of `trajectories` by PPO or A2C; see `lidarnaut.agents.trajectories`."""

    width: Width = 32
    """Number of features per twist."""
    hidden: Width = 64
    """Width of the hidden layers of the value function."""


class DecisionNetworkConfig(Section):
    """Network that selects frontiers by PPO or A2C; see `lidarnaut.agents.frontiers.network`."""

    width: Width = 64
    """Width of all layers."""
    heads: Width = 4
    """Number of attention heads; must divide `width`."""
    prior: float = Field(default=10.0, ge=0)
    """Weight of the prior policy in the logits; larger values reduce early exploration, 0 disables the prior."""
    prior_policy: str = "rule"
    """Policy that an untrained network imitates: `rule` (`gain_over_cost`), the folder of a frontier score or evolution
    run, or `pretrained/NAME`."""

    @model_validator(mode="after")
    def _divides(self) -> "DecisionNetworkConfig":
        if self.width % self.heads:
            raise ValueError(f"heads {self.heads} does not divide width {self.width}")
        return self


class EvaluationConfig(Section):
    """Evaluation in test worlds, with the same episodes each time."""

    every: Count = 25_000
    """Environment steps between evaluations."""
    episodes: Side = 20
    """Episodes per evaluation; episode i has seed i."""
    references: tuple[str, ...] = ("random",)
    """Classic policies to measure once on the same episodes, by name or `module:attribute`."""
    environment: dict[str, Any] = {}
    """Environment arguments other than in training, such as `world`. Later uses of the policy keep `observations`."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Environment arguments that differ from training, with lists as tuples."""
        return {name: _tuples(value) for name, value in self.environment.items()}


class CheckpointConfig(Section):
    """Schedule of checkpoints."""

    every: Count = 20_000
    """Maximum environment steps between checkpoints; at least one rollout."""
    keep: int = Field(default=3, ge=2)
    """Number of newest checkpoints to keep."""


class EvolutionConfig(Section):
    """Evolution of a frontier score by CMA-ES; see `lidarnaut.agents.frontiers.evolution`."""

    algorithm: Literal["evolution"]
    """Constant `evolution`, which selects this configuration."""
    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Experiment name, which begins the run folder's name."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of all random generators."""
    generations: Count = 100
    """Number of generations."""
    population: int = Field(default=14, ge=4, le=100_000)
    """Individuals per generation."""
    tasks: Side = 24
    """Episodes explored by each individual of a generation."""
    sigma: PositiveFloat = 0.06
    """Initial standard deviation of each weight, times the spread of its feature."""
    families: tuple[str, ...] = ("rooms", "maze", "warehouse", "caves")
    """Procedural families of the training worlds."""
    validation_tasks: Side = 240
    """Number of validation episodes, always the same; results do not affect training."""
    validate_every: Count = 10
    """Generations between two validations."""
    num_workers: Side | None = None
    """Worker processes; null uses one per core."""

    @field_validator("families")
    @classmethod
    def _know_families(cls, families: tuple[str, ...]) -> tuple[str, ...]:
        if unknown := [name for name in families if name not in SIDES]:
            raise ValueError(f"unknown family {explain_unknown(unknown[0], SIDES)}")
        return families


class TrainingConfig(Section):
    """Reinforcement learning experiment."""

    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Experiment name, which begins the run folder's name."""
    total_steps: Count
    """Total environment steps of all sub-environments, rounded up to whole rollouts."""
    algorithm: str
    """Algorithm of stable-baselines3 or sb3-contrib by name, or `module:attribute` of a derived class."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of all random generators."""
    num_envs: Side = 16
    """Number of parallel sub-environments."""
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Device of torch; `auto` uses a GPU if available. Small networks need no GPU."""
    torch_threads: Side = 1
    """Threads of torch; more than one slows small networks."""
    environment: EnvironmentConfig = EnvironmentConfig()
    """Training environment."""
    hyperparameters: dict[str, Any] = {}
    """Arguments of the algorithm class. `lin_3e-4` decreases linearly to zero; `action_noise: 0.1` is the standard
    deviation of Gaussian noise."""
    network: dict[str, Any] = {}
    """Network settings: keys of `NetworkConfig`, `GaussianNetworkConfig`, `TrajectoryNetworkConfig` or
    `DecisionNetworkConfig`."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Evaluation during training."""
    checkpoints: CheckpointConfig = CheckpointConfig()
    """Schedule of checkpoints."""

    @field_validator("algorithm")
    @classmethod
    def _know_algorithm(cls, algorithm: str) -> str:
        if ":" not in algorithm and algorithm not in ALGORITHMS:
            known = [*ALGORITHMS, "evolution"]
            raise ValueError(f"unknown algorithm {explain_unknown(algorithm, known)}, or module:attribute of your own")
        return algorithm


def parse_config(data: Mapping[str, Any], source: str) -> TrainingConfig | EvolutionConfig:
    """Parse a training or evolution configuration; raise ValueError with `source` and wrong keys."""
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
    """Return nested mappings with new values at dotted keys; raise ValueError if a parent is not a mapping."""
    changed: dict[str, Any] = copy.deepcopy(dict(data))
    for key, value in changes.items():
        *parents, name = key.split(".")
        section = changed
        for parent in parents:
            section[parent] = {} if section.get(parent) is None else section[parent]
            section = section[parent]
            if not isinstance(section, dict):
                raise ValueError(f"--{key}: {parent} is {section!r}, not a mapping")
        section[name] = value
    return changed


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(one) for key, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
