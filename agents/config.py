"""Configuration of an experiment."""

import dataclasses
import math
import warnings
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, field_validator, model_validator

from envs.files import explain_unknown, load_object
from envs.slam import DEFAULT_SLAM
from envs.tasks.rewards import RewardWeights
from envs.worlds import FAMILIES


class Section(BaseModel):
    """Part of a configuration: immutable, and unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)


Width = Annotated[int, Field(ge=1, le=8192)]
"""Width of a layer; more takes all memory before anything is learned."""
Count = Annotated[int, Field(ge=1, le=10**12)]
"""Number of steps or episodes."""
Side = Annotated[int, Field(ge=1, le=100_000)]
"""Number of what exists at the same time."""


class EnvironmentConfig(Section):
    """Where to learn. The names are those of the environment's arguments, which it documents and checks."""

    id: str = "lidarnaut/Explore-v0"
    """Environment; `module:id` imports the module that registers it first."""
    world: str = "rooms"
    """Library world, procedural family, path, or `module:attribute` of one of your own."""
    world_size: tuple[PositiveFloat, PositiveFloat] | None = None
    """Outer size (x, y) of a procedural world [m]; null leaves it to the family."""
    robot: str | None = None
    """Library robot, path, or `module:attribute`; null takes the world's usual robot."""
    physics: str = "kinematic"
    """`kinematic` or `bullet`."""
    slam: str = DEFAULT_SLAM
    """SLAM in the loop, by name or as `module:attribute`."""
    control_hz: PositiveFloat = 5.0
    """Decisions per second."""
    max_decision_time: PositiveFloat | None = None
    """Longest drive to a frontier until the next choice [s], where frontiers are chosen; null leaves it to the
    environment."""
    time_limit: PositiveFloat | None = None
    """Length of an episode [s]; null gives a time that grows with the explorable area."""
    target_coverage: float = Field(default=0.99, gt=0, le=1)
    """Explored fraction that ends the episode."""
    reward: dict[str, float] = Field(default_factory=lambda: dataclasses.asdict(RewardWeights()))
    """Weights of the reward's terms; those left out keep the environment's own."""
    reward_object: str | None = None
    """`module:attribute` of reward weights of your own, terms included; replaces `reward`."""
    randomize: dict[str, tuple[float, float]] | None = None
    """(low, high) by the name of a parameter of the robot, from which each episode draws the true robot's."""
    observations: tuple[str, ...] | None = None
    """Parts of the observation, by name; null leaves them to the environment."""
    clip_actions: bool = False
    """Whether the environment cuts actions to [-1, 1] rather than refuse them. PPO clips them in any case."""

    vectorization: Literal["native", "sync", "async"] = "native"
    """How sub-environments run side by side: in the package's own vector environment, one after the other, or in a
    process each."""
    num_workers: int | None = Field(default=None, ge=0, le=100_000)
    """Processes of the native vector environment, 0 for none but this one; null takes as many as there are cores."""

    @property
    def arguments(self) -> dict[str, Any]:
        """The environment's own arguments."""
        arguments = self.model_dump(exclude={"id", "vectorization", "num_workers", "reward_object"})
        for name in ("max_decision_time", "observations", "randomize"):  # arguments of some environments only
            if arguments[name] is None:
                del arguments[name]
        return arguments | ({"reward": load_object(self.reward_object)} if self.reward_object else {})

    @field_validator("vectorization", mode="before")
    @classmethod
    def _rename(cls, vectorization: Any) -> Any:
        if vectorization == "lanes":
            warnings.warn("vectorization 'lanes' is called 'native' now", DeprecationWarning, stacklevel=2)
            return "native"
        return vectorization

    @field_validator("reward")
    @classmethod
    def _complete_reward(cls, reward: dict[str, float]) -> dict[str, float]:
        terms = dataclasses.asdict(RewardWeights())
        if unknown := [name for name in reward if name not in terms]:
            raise ValueError(f"unknown term {explain_unknown(unknown[0], terms)}")
        return terms | reward


class PPOConfig(Section):
    """Proximal policy optimisation, in the terms of stable-baselines3."""

    learning_rate: PositiveFloat = 3e-4
    """Step size of Adam at the start."""
    anneal: bool = True
    """Whether the learning rate falls linearly to zero at `total_steps`."""
    num_steps: Side = 128
    """Steps of each environment between two updates."""
    batch_size: int = Field(default=512, ge=2)
    """Samples per gradient step."""
    num_epochs: Side = 4
    """Passes over the samples of an update."""
    gamma: float = Field(default=0.99, gt=0, le=1)
    """Discount per step. 1 where steps last for different times: there it treats all seconds alike."""
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    """Generalised advantage estimation: 0 trusts the value network, 1 the returns."""
    clip_range: PositiveFloat = 0.2
    """How far an update may move the probability of an action, as a ratio."""
    entropy_coef: float = Field(default=0.0, ge=0)
    """Weight of the entropy bonus."""
    value_coef: PositiveFloat = 0.5
    """Weight of the value loss."""
    max_grad_norm: PositiveFloat = 0.5
    """Norm to which gradients are clipped."""
    target_kl: PositiveFloat | None = None
    """Divergence at which an update stops early; null never."""


class NetworkConfig(Section):
    """Network that drives, and the first spread of its actions."""

    features: Width = 128
    """Width of the features that policy and value share."""
    channels: Width = 16
    """Features of a patch of a map crop."""
    hidden: Width = 64
    """Width of the hidden layer of the policy and of the value."""
    log_std: float = Field(default=-0.5, ge=-20, le=20)
    """First logarithm of the actions' standard deviation, as a fraction of the robot's limits."""
    speed: float = Field(default=0.0, ge=-1, le=1)
    """First mean of the forward speed, as a fraction of the robot's limit: a robot at rest discovers little."""
    pursuit: float = Field(default=0.0, ge=0, le=1)
    """Weight in the mean of the twist that follows the first path of the observation `plan`; 0 leaves it out."""


class DecisionNetworkConfig(Section):
    """Network that chooses frontiers; see `agents.frontiers.network`."""

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
    """Explorers, by name or as `module:attribute`, that are measured on the same episodes, once, before training. Where
    frontiers are chosen, they are rules and policies of decisions."""
    world: str | None = None
    """World of these episodes, as `environment.world`; null takes that of the training."""


class CheckpointConfig(Section):
    """When the state of the training is saved."""

    every: Count = 20_000
    """Training steps between checkpoints, at most: what a kill can cost. Not less than an update takes."""
    keep: int = Field(default=3, ge=2)
    """Newest checkpoints that are kept."""


class EvolutionConfig(Section):
    """Evolution of a frontier score by CMA-ES; see `agents.frontiers.evolution`."""

    algorithm: Literal["evolution"]
    """Tells this configuration from that of PPO."""
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
        if unknown := [name for name in families if name not in FAMILIES]:
            raise ValueError(f"unknown family {explain_unknown(unknown[0], FAMILIES)}")
        return families


class TrainingConfig(Section):
    """An experiment."""

    experiment: str = Field(pattern=r"^[A-Za-z0-9._-]+$")
    """Name, the first part of the run folder's."""
    total_steps: Count
    """Environment steps to train for, all environments together; rounded up to whole updates."""
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
    ppo: PPOConfig = PPOConfig()
    """How to learn."""
    network: NetworkConfig = NetworkConfig()
    """What learns to drive."""
    decision_network: DecisionNetworkConfig = DecisionNetworkConfig()
    """What learns to choose, in environments in which an action is a choice of a frontier."""
    evaluation: EvaluationConfig = EvaluationConfig()
    """How progress is measured."""
    checkpoints: CheckpointConfig = CheckpointConfig()
    """When the state is saved."""

    @model_validator(mode="after")
    def _fits_together(self) -> "TrainingConfig":
        if self.checkpoints.every < self.rollout_steps:
            raise ValueError(
                f"checkpoints.every is {self.checkpoints.every}, but an update takes num_envs * ppo.num_steps = "
                f"{self.rollout_steps} steps; checkpoints can only lie between updates"
            )
        if self.rollout_steps % self.ppo.batch_size:
            raise ValueError(
                f"ppo.batch_size {self.ppo.batch_size} does not divide num_envs * ppo.num_steps = {self.rollout_steps}"
            )
        return self

    @property
    def rollout_steps(self) -> int:
        """Environment steps between two updates."""
        return self.num_envs * self.ppo.num_steps

    @property
    def num_updates(self) -> int:
        """Updates that `total_steps` take."""
        return math.ceil(self.total_steps / self.rollout_steps)
