"""Configuration of training runs, and its YAML files."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveFloat, field_validator, model_validator

from lidarnaut.agents.frontiers.tasks import SIDES
from lidarnaut.envs.files import explain_unknown, parse_record, read_mapping

ALGORITHMS = {
    **dict.fromkeys(("PPO", "A2C", "SAC", "TD3", "DDPG", "DQN"), "stable_baselines3"),
    **dict.fromkeys(("TQC", "CrossQ", "QRDQN", "TRPO", "RecurrentPPO", "MaskablePPO"), "sb3_contrib"),
}
"""Python package of each reinforcement learning algorithm, by algorithm name."""


class Section(BaseModel):
    """Base of immutable configuration sections; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _take_one_for_several(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        several = {name for name, one in cls.model_fields.items() if get_origin(one.annotation) is tuple}
        taken = {key: (value,) for key, value in data.items() if key in several and isinstance(value, str)}
        return data | taken | {key: () for key in several if data.get(key) is True}  # an option without a value


Width = Annotated[int, Field(ge=1, le=8192)]
Count = Annotated[int, Field(ge=1, le=10**12)]
Side = Annotated[int, Field(ge=1, le=100_000)]


class RunConfig(Section):
    """Base of the configurations of trainings."""

    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Experiment name, the first part of the run folder's name."""
    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of all random generators."""


class EnvironmentConfig(Section):
    """Environment id and execution of parallel sub-environments. Further keys are environment arguments."""

    model_config = ConfigDict(extra="allow")

    id: str = "lidarnaut/Explore-v0"
    """Gymnasium id; `module:id` imports the module first."""
    vectorization: Literal["native", "sync", "async"] = "native"
    """Execution of sub-environments: `native` (several per process, by this package), `sync` (one after another in the
    main process), or `async` (one process each)."""
    num_workers: int | None = Field(default=None, ge=0, le=100_000)
    """Number of worker processes if `vectorization` is `native`. 0 uses none; null uses one worker per core, or none if
    several processes train together."""

    robots: tuple[str, ...] = ()
    """Robots for training, each in an equal share of the sub-environments. They replace the argument `robot`.
    Evaluations use the first robot."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of the environment; lists are converted to tuples."""
        own = {name: _tuples(value) for name, value in (self.model_extra or {}).items()}
        return own | ({"robot": self.robots[0]} if self.robots else {})


class NetworkConfig(Section):
    """Settings of the default network, with one encoder per entry of the observation."""

    features: Width = 128
    """Width of the feature layer that policy and value function share."""
    channels: Width = 16
    """Number of output channels of the convolution over map patches of 10 x 10 pixels."""
    hidden: Width = 64
    """Width of the hidden layers of policy and value function."""


class GaussianNetworkConfig(NetworkConfig):
    """Settings of the network with Gaussian velocity commands, for on-policy algorithms."""

    log_std: float = Field(default=-0.5, ge=-20, le=20)
    """Initial natural logarithm of the standard deviation of actions. Actions are velocities divided by the robot's
    limits."""
    speed: float = Field(default=0.0, ge=-1, le=1)
    """Initial mean forward speed, divided by the robot's maximum. Driving forward helps early exploration."""


class TrajectoryNetworkConfig(Section):
    """Settings of the network that selects one of the candidate velocity commands, for PPO and A2C."""

    width: Width = 32
    """Number of learned features per candidate command."""
    hidden: Width = 64
    """Width of the hidden layers of the value function."""
    prior: float = Field(default=0.0, ge=0, le=1000)
    """Initial weight of progress towards the goal or along the path in the logits of commands, with weights of contacts
    and gaps relative to it. With large values, the untrained policy follows the path past obstacles; with 0, it chooses
    at random."""


class DecisionNetworkConfig(Section):
    """Settings of the attention network that selects frontiers, for PPO and A2C."""

    width: Width = 64
    """Width of all layers."""
    heads: Width = 4
    """Number of attention heads; must divide `width`."""
    prior: float = Field(default=10.0, ge=0)
    """Weight of the scores of `prior_policy` in the logits of frontiers. Larger values reduce early exploration; 0
    disables it."""
    prior_policy: str = "rule"
    """Policy that the untrained network imitates: `rule` (`gain_over_cost`: unknown area / path cost), the folder of a
    frontier score or evolution run, or `pretrained/NAME`."""

    @model_validator(mode="after")
    def _divides(self) -> "DecisionNetworkConfig":
        if self.width % self.heads:
            raise ValueError(f"heads {self.heads} does not divide width {self.width}")
        return self


class EvaluationConfig(Section):
    """Settings of evaluations, with the same episodes each time."""

    every: Count = 25_000
    """Number of environment steps between evaluations."""
    at_start: bool | None = None
    """Whether the untrained policy is evaluated; null: only a network with a `prior` above 0."""
    episodes: Side = 20
    """Number of episodes per evaluation, in validation worlds and from validation seeds."""
    test_episodes: Side | None = None
    """Number of test episodes of the best checkpoint and of the references; episode i has seed i. null takes
    `episodes`."""
    references: tuple[str, ...] = ("random",)
    """Non-learned policies, by name or `module:attribute`, evaluated in the test episodes for comparison."""
    environment: dict[str, Any] = {}
    """Environment arguments that differ in evaluations, such as `world`. Such values of `observations` and
    `collision_monitor` also apply when the trained policy is used."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Environment arguments that differ from training; lists are converted to tuples."""
        return {name: _tuples(value) for name, value in self.environment.items()}


class CheckpointConfig(Section):
    """Interval and number of saved checkpoints."""

    every: Count = 20_000
    """Maximum number of environment steps between checkpoints. Must not be less than the steps between two policy
    updates."""
    keep: int = Field(default=3, ge=2)
    """Number of newest checkpoints to keep."""


def _check_families(families: tuple[str, ...]) -> tuple[str, ...]:
    if unknown := [name for name in families if name not in SIDES]:
        raise ValueError(f"unknown family {explain_unknown(unknown[0], SIDES)}")
    return families


Families = Annotated[tuple[str, ...], AfterValidator(_check_families)]


class EvolutionConfig(RunConfig):
    """Settings to optimize a linear frontier score by CMA-ES; see `lidarnaut.agents.frontiers.evolution`."""

    algorithm: Literal["evolution"]
    """Always `evolution`, which selects CMA-ES instead of reinforcement learning."""
    generations: Count = 100
    """Number of generations."""
    population: int = Field(default=14, ge=4, le=100_000)
    """Number of individuals (weight vectors) per generation."""
    tasks: Side = 24
    """Number of exploration episodes to evaluate each individual (weight vector)."""
    sigma: PositiveFloat = 0.06
    """Initial standard deviation of score weights, for features scaled to unit standard deviation."""
    families: Families = ("rooms", "maze", "warehouse", "caves")
    """Families of generated worlds for training."""
    validation_tasks: Side = 240
    """Number of validation episodes, the same each time. Results do not affect training."""
    validate_every: Count = 10
    """Number of generations between two validations."""
    num_workers: Side | None = None
    """Number of worker processes; null uses one per core."""


class CompletionConfig(RunConfig):
    """Settings to train a network that completes maps; see `lidarnaut.agents.completion.training`."""

    algorithm: Literal["completion"]
    """Always `completion`, which selects supervised learning instead of reinforcement learning."""
    episodes: Count = 1200
    """Number of explorations whose maps are completed in training."""
    validation_episodes: Side = 60
    """Number of explorations, in training worlds, whose maps are completed in validations."""
    families: Families = tuple(SIDES)
    """Families of generated worlds for explorations; others are worlds of the library."""
    total_steps: Count = 5000
    """Number of gradient steps."""
    batch_size: Side = 16
    """Number of crops of maps in a gradient step."""
    crop: Annotated[int, Field(ge=32, le=1024, multiple_of=16)] = 96
    """Side of a crop, in cells of 0.2 m."""
    horizon: PositiveFloat = 3.0
    """Unknown cells count in the loss up to this distance from known floor [m]."""
    learning_rate: PositiveFloat = 3e-3
    """Highest learning rate."""
    validate_every: Count = 500
    """Number of gradient steps between two validations, each with a checkpoint."""
    num_workers: Side | None = None
    """Number of processes that explore; null uses one per core."""
    torch_threads: Side | None = None
    """Number of threads of torch; null leaves the number to torch."""


class TrainingConfig(RunConfig):
    """Settings of a training by reinforcement learning."""

    total_steps: Count
    """Total number of environment steps over all sub-environments, rounded up to whole updates."""
    algorithm: str
    """Algorithm class: name in stable-baselines3 or sb3-contrib, or `module:attribute` of a derived class."""
    recipe: str | None = None
    """Recipe that the configuration was merged with. In a configuration: name of a recipe, by default that of
    `environment.id`; null for none."""
    num_envs: Side = 16
    """Number of parallel sub-environments."""
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Device of torch; `auto` uses a GPU if available. Small networks need no GPU."""
    processes: Annotated[int, Field(ge=1, le=1024)] | None = None
    """Number of processes that train together, each with an equal share of the sub-environments and minibatches; they
    average their gradients. On-policy algorithms only. null: one per core, or one if OMP_NUM_THREADS is 1."""
    torch_threads: Side | None = None
    """Number of threads of torch in each process; null uses one: more slow small networks."""
    environment: EnvironmentConfig = EnvironmentConfig()
    """Environment for training."""
    hyperparameters: dict[str, Any] = {}
    """Arguments of the algorithm class. A value `lin_3e-4` decreases linearly from 3e-4 to zero. `action_noise: 0.1`
    adds Gaussian noise to actions, with standard deviation 0.1."""
    network: dict[str, Any] = {}
    """Network settings: keys of `NetworkConfig`, `GaussianNetworkConfig`, `TrajectoryNetworkConfig` or
    `DecisionNetworkConfig`."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """Settings of evaluations during training."""
    checkpoints: CheckpointConfig = CheckpointConfig()
    """Interval and number of saved checkpoints."""
    logger: tuple[Literal["tensorboard", "wandb", "mlflow"], ...] = ("tensorboard",)
    """Where scalars are logged: `tensorboard` in the run folder, `wandb` (Weights & Biases), `mlflow`."""

    @field_validator("algorithm")
    @classmethod
    def _know_algorithm(cls, algorithm: str) -> str:
        if ":" not in algorithm and algorithm not in ALGORITHMS:
            known = [*ALGORITHMS, *OTHER_KINDS]
            raise ValueError(f"unknown algorithm {explain_unknown(algorithm, known)}, or module:attribute of your own")
        return algorithm


Config = TrainingConfig | EvolutionConfig | CompletionConfig
OTHER_KINDS: dict[str, type[EvolutionConfig] | type[CompletionConfig]] = {
    "evolution": EvolutionConfig,
    "completion": CompletionConfig,
}
"""Configurations that are no reinforcement learning, by algorithm."""


def parse_config(data: Mapping[str, Any], source: str) -> Config:
    """Parse the configuration of a training from nested mappings; `source` names their origin.

    Raises:
        ValueError: if a key or value is wrong.
    """
    kind: Any = OTHER_KINDS.get(str(data.get("algorithm")), TrainingConfig)
    return parse_record(data, source, kind)


CONFIGURATIONS = Path(__file__).resolve().parents[1] / "configs"
RECIPES = {path.stem: path for path in sorted((CONFIGURATIONS / "recipes").glob("*.yaml"))}
"""Files of the recipes, by name."""


def find_configuration(name: str, key: str) -> Path:
    """Return the file of a configuration: a path, or the name of a packaged one, such as `explore_frontiers`.

    `key`: top-level key of the kind of configuration: `experiment` for trainings, `policies` for evaluations.

    Raises:
        ValueError: if there is no such configuration; the message lists the packaged ones of this kind.
    """
    if name.endswith((".yaml", ".yml")) or Path(name).is_file():
        return Path(name)
    known = {path.stem: path for path in sorted(CONFIGURATIONS.rglob("*.yaml")) if key in read_mapping(path)}
    if name not in known:
        further = f"; recipes need no file: --environment.id lidarnaut/ID, with ID of {', '.join(RECIPES)}"
        further = further if key == "experiment" else ""
        raise ValueError(f"unknown configuration {explain_unknown(name, known)}, and paths of YAML files{further}")
    return known[name]


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings: those of `base`, updated by `changes`.

    Mappings are merged, except `observations`, whose keys are the parts of an observation.
    """
    merged = dict(base)
    for key, value in changes.items():
        are_nested = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping) and key != "observations"
        merged[key] = merge(merged[key], value) if are_nested else value
    return merged


def change(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of nested mappings with changed values, by dotted keys such as `network.hidden`.

    Raises:
        ValueError: if a parent key does not hold a mapping.
    """
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
