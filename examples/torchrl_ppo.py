"""TorchRL's PPO with `GymEnv`, a collector and a clipped loss. See `examples/requirements.txt`."""

import tyro

import lidarnaut.agents  # noqa: F401  (registers the environments; idle threads of torch sleep, if before torch)
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import CatTensors, Compose, GymEnv, StepCounter, TransformedEnv
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE


def make_env() -> TransformedEnv:
    """Return an environment with a single observation vector, `inputs`."""
    arguments = {
        "world_size": (8.0, 8.0),
        "control_hz": 5.0,
        "physics": "kinematic",
        "observations": ("scan", "motion"),
    }
    env = GymEnv("lidarnaut/ExploreRooms-v0", time_limit=60.0, **arguments)
    return TransformedEnv(env, Compose(CatTensors(["scan", "motion"], "inputs", del_keys=False), StepCounter()))


def main(total_timesteps: int = 40_000, batch_size: int = 2048, epochs: int = 4) -> float:
    """Train and return the mean reward per step of the last batch.

    Args:
        total_timesteps: Total number of environment steps.
        batch_size: Environment steps per update.
        epochs: Passes over each batch.
    """
    torch.manual_seed(0)
    env = make_env()
    num_inputs = env.observation_spec["inputs"].shape[-1]
    network = nn.Sequential(MLP(num_inputs, 4, num_cells=[64, 64]), NormalParamExtractor())
    parameters = TensorDictModule(network, in_keys=["inputs"], out_keys=["loc", "scale"])
    actor = ProbabilisticActor(
        TensorDictSequential(parameters),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,  # actions lie in [-1, 1]
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(num_inputs, 1, num_cells=[64, 64]), in_keys=["inputs"])
    advantage = GAE(gamma=0.995, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.001)
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
    collector = Collector(env, actor, frames_per_batch=batch_size, total_frames=total_timesteps)
    mean = 0.0
    for data in collector:
        for _ in range(epochs):
            advantage(data)
            for rows in torch.randperm(batch_size).chunk(8):
                terms = loss(data.reshape(-1)[rows])
                sum(terms[f"loss_{name}"] for name in ("objective", "critic", "entropy")).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
                optimizer.zero_grad()
        mean = float(data["next", "reward"].mean())
        print(f"mean reward per step: {mean:.3f}")
    collector.shutdown()
    return mean


if __name__ == "__main__":
    tyro.cli(main)
