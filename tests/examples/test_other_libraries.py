"""One short run of each library of the guide to other libraries, with an environment of the package."""

import sys
from functools import partial

import gymnasium
import numpy as np
import pytest
import yaml

import lidarnaut.agents  # noqa: F401  (registers the environments, before torch)

ID = "lidarnaut/ReachGoal-v0"
QUICK = {"world": "rooms", "world_size": (6, 6), "physics": "kinematic", "time_limit": 5.0, "control_hz": 5.0}


@pytest.fixture
def load(request):
    """Import the library that the test is named after, or skip the test."""
    library = request.node.name.removeprefix("test_").partition("[")[0]
    return lambda module="": pytest.importorskip(f"{library}{module}", exc_type=ImportError)


def make(**arguments):
    return gymnasium.make(ID, observations=("scan", "goal", "motion"), **QUICK, **arguments)


def test_minari(load, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env, rewards, scans = load().DataCollector(make(fixed_info=True), record_infos=True), [], []
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


def test_skrl(load):
    torch = pytest.importorskip("torch")
    options = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP, "clip_actions": True}
    vector = gymnasium.make_vec(ID, num_envs=4, observations=("scan", "goal"), **options, **QUICK)
    env = load(".envs.wrappers.torch").wrap_env(vector)
    memory = load(".memories.torch").RandomMemory(memory_size=64, num_envs=4, device="cpu")
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


def test_sbx(load):
    env = gymnasium.wrappers.FlattenObservation(make())
    model = load().PPO("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0)
    assert model.learn(128).num_timesteps == 128


def test_rl_zoo3(load, tmp_path, monkeypatch):
    settings = {"n_envs": 2, "n_timesteps": 128, "policy": "MultiInputPolicy", "n_steps": 32, "batch_size": 32}
    (tmp_path / "ppo.yml").write_text(yaml.safe_dump({ID: settings}))
    command = ["train", "--algo", "ppo", "--env", ID, "--gym-packages", "lidarnaut", "--eval-freq", "-1"]
    command += [
        "--env-kwargs",
        "world:'rooms'",
        "physics:'kinematic'",
        "time_limit:5.0",
        "observations:('scan','goal')",
    ]
    command += ["--conf-file", str(tmp_path / "ppo.yml"), "--log-folder", str(tmp_path / "logs")]
    train = load(".train").train
    monkeypatch.setattr(sys, "argv", command)
    train()
    assert len(list((tmp_path / "logs").rglob("*.zip"))) == 1


@pytest.mark.parametrize("id", ["Explore", "ReachGoal"])
def test_tianshou(id, load):
    """The buffer stores fixed info, and finds no missing values."""
    data = load(".data")

    class Standing(load(".algorithm.algorithm_base").Policy):
        def forward(self, batch, state=None, **_):
            return data.Batch(act=np.zeros((len(batch.obs.motion), 2), dtype=np.float32))

    arguments = {"observations": ("motion",), "time_limit": 0.5, "physics": "kinematic"}
    make = partial(gymnasium.make, f"lidarnaut/{id}-v0", fixed_info=True, **arguments)
    env = make()
    policy = Standing(action_space=env.action_space, observation_space=env.observation_space)
    buffer = data.VectorReplayBuffer(10_000, buffer_num=4)
    vector = load(".env").DummyVectorEnv([make] * 4)
    collector = data.Collector(policy, vector, buffer, raise_on_nan_in_buffer=True)
    collector.reset()
    assert collector.collect(n_step=48).n_collected_episodes == 8
    ended = buffer.truncated.astype(bool)[: len(buffer)]
    assert set(buffer.info.end_reason[: len(buffer)][ended]) <= {"time_limit", ""}
