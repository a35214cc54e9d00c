"""One short run of a library with an environment of the package: `learning.py LIBRARY`; prints its number of steps."""

import json
import os
import sys
import tempfile
from functools import partial
from pathlib import Path

import lidarnaut.agents  # noqa: F401  (registers the environments, before torch)
import gymnasium
import numpy as np
import torch

ID = "lidarnaut/ReachGoal-v0"
QUICK = {"world": "rooms", "world_size": (6, 6), "physics": "kinematic", "time_limit": 5.0, "control_hz": 5.0}
make = partial(gymnasium.make, ID, observations=("scan", "goal", "motion"), **QUICK)


def minari(folder):
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    import minari

    env, rewards, scans = minari.DataCollector(make(fixed_info=True), record_infos=True), [], []
    for seed in range(3):
        scans.append(env.reset(seed=seed)[0]["scan"])
        done = False
        while not done:
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            rewards.append(reward)
            scans.append(observation["scan"])
            done = terminated or truncated
    dataset = env.create_dataset("lidarnaut/reach-v0", eval_env=ID, algorithm_name="random")
    episodes = list(dataset.iterate_episodes())
    assert np.allclose(np.concatenate([one.rewards for one in episodes]), rewards)
    assert np.array_equal(np.concatenate([one.observations["scan"] for one in episodes]), np.array(scans))
    assert dataset.recover_environment().observation_space == make().observation_space
    return len(rewards)


def skrl(folder):
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory

    options = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP, "clip_actions": True}
    env = wrap_env(gymnasium.make_vec(ID, num_envs=4, observations=("scan", "goal"), **options, **QUICK))
    memory = RandomMemory(memory_size=64, num_envs=4, device="cpu")
    for name, size in (("observations", env.observation_space), ("actions", env.action_space), ("rewards", 1)):
        memory.create_tensor(name=name, size=size)
    observations, _ = env.reset()
    for _ in range(64):
        actions = torch.rand(4, 2) * 2 - 1
        following, rewards, *_ = env.step(actions)
        memory.add_samples(observations=observations, actions=actions, rewards=rewards)
        observations = following
    (found,) = memory.sample_all(names=["observations"])
    assert memory.filled
    assert torch.isfinite(found[0]).all()
    return 4 * 64


def sbx(folder):
    from sbx import PPO

    model = PPO(
        "MlpPolicy", gymnasium.wrappers.FlattenObservation(make()), n_steps=64, batch_size=32, n_epochs=1, seed=0
    )
    return model.learn(128).num_timesteps


def rl_zoo3(folder):
    import yaml
    from rl_zoo3.train import train

    settings = {"n_envs": 2, "n_timesteps": 128, "policy": "MultiInputPolicy", "n_steps": 32, "batch_size": 32}
    (folder / "ppo.yml").write_text(yaml.safe_dump({ID: settings}))
    arguments = "world:'rooms'", "physics:'kinematic'", "time_limit:5.0", "observations:('scan','goal')"
    sys.argv = ["train", "--algo", "ppo", "--env", ID, "--env-kwargs", *arguments, "--log-folder", str(folder / "logs")]
    sys.argv += ["--conf-file", str(folder / "ppo.yml"), "--eval-freq", "-1", "--gym-packages", "lidarnaut"]
    train()
    assert len(list((folder / "logs").rglob("*.zip"))) == 1
    return 128


RUNS = {"minari": minari, "skrl": skrl, "sbx-rl": sbx, "rl_zoo3": rl_zoo3}

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as created:
        steps = RUNS[sys.argv[1]](Path(created))
    print(json.dumps({"steps": int(steps)}))
