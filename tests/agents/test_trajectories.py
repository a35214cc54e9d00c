import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.utils import ConstantSchedule

from lidarnaut.agents.trajectories import TrajectoryNetwork, TrajectoryPolicy, TwistChoice
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations.scan import SPEED_RANGE
from lidarnaut.envs.observations.trajectories import NUMBERS, TWISTS

TABLE = torch.from_numpy(TWISTS)
ACTIONS = spaces.Box(-1.0, 1.0, (2,))
PARTS = {
    "trajectories": spaces.Box(-np.inf, np.inf, (len(TWISTS), NUMBERS)),
    "motion": spaces.Box(-1.0, 1.0, (6,)),
    "limits": spaces.Box(0.0, 1.0, (5,)),
}


def sample(space, batch=5):
    rng = torch.Generator().manual_seed(1)
    return {key: torch.rand(batch, *box.shape, generator=rng) for key, box in space.spaces.items()}


def test_samples_are_twists_and_have_the_probabilities_of_their_logits():
    logits = torch.randn(4, 66, generator=torch.Generator().manual_seed(0))
    choice = TwistChoice(TABLE).proba_distribution(logits)
    expected = logits.log_softmax(dim=1)
    for k in (0, 17, 54):
        torch.testing.assert_close(choice.log_prob(TABLE[k].expand(4, 2)), expected[:, k])
    torch.testing.assert_close(choice.mode(), TABLE[logits.argmax(dim=1)])
    torch.testing.assert_close(choice.entropy(), -(expected.exp() * expected).sum(dim=1))
    assert (torch.cdist(choice.sample(), TABLE).amin(dim=1) == 0).all()


@pytest.mark.parametrize(("name", "size"), [("goal", 4), ("carrot", 3), ("plan", 27)])
def test_twists_are_rated_by_what_they_lead_to_and_by_the_goal(name, size):
    space = spaces.Dict(PARTS | {name: spaces.Box(-1.0, 1.0, (size,))})
    network = TrajectoryNetwork(space, width=8, hidden=8)
    seen = sample(space)
    logits, values = network(seen)
    assert logits.shape == (5, len(TWISTS))
    assert values.shape == (5, 1)
    # The outcome of a twist changes only the logit of this twist.
    changed = {**seen, "trajectories": seen["trajectories"].clone()}
    changed["trajectories"][:, 3, 0] += 0.5
    others = torch.arange(len(TWISTS)) != 3
    torch.testing.assert_close(network(changed)[0][:, others], logits[:, others])
    assert not torch.equal(network(changed)[0][:, 3], logits[:, 3])
    assert not torch.equal(network({**seen, name: seen[name] * 0.5})[0], logits)


def test_observations_that_are_missing_are_named():
    with pytest.raises(ValueError, match=r"\['trajectories', 'motion', 'limits'\] and `goal`, `carrot` or `plan`"):
        TrajectoryNetwork(spaces.Dict(PARTS), width=8, hidden=8)
    others = {"goal": PARTS["motion"], "trajectories": spaces.Box(-np.inf, np.inf, (7, NUMBERS))}
    with pytest.raises(ValueError, match="rates 66 or 130 twists, not 7"):
        TrajectoryNetwork(spaces.Dict(PARTS | others), width=8, hidden=8)


@pytest.mark.parametrize(
    ("id", "arguments"),
    [("ReachGoal-v0", {}), ("ReachGoal-v0", {"goal_given": "bearing"}), ("Navigate-v0", {"world": "hall"})],
)
def test_goals_of_all_tasks_are_read_in_metres(id, arguments):
    parts = ("trajectories", "goal", "motion", "limits")
    env = gymnasium.make(f"lidarnaut/{id}", physics="kinematic", observations=parts, **arguments)
    lidar_env = env.unwrapped
    network = TrajectoryNetwork(env.observation_space, width=8, hidden=8)
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        goal = lidar_env.belief.pose.between(Pose2D(*lidar_env.task.goal[:2], 0.0))
        scaled = network._goal({name: torch.from_numpy(part)[None] for name, part in observation.items()})[0]
        found = scaled * SPEED_RANGE * float(observation["limits"][0])
        away = math.hypot(goal.x, goal.y)
        expected = min(away, 10.0) if arguments.get("goal_given", "pose") == "pose" else 10.0
        assert found.norm() == pytest.approx(expected if id == "ReachGoal-v0" else away, rel=1e-4)
        assert math.atan2(found[1], found[0]) == pytest.approx(math.atan2(goal.y, goal.x), abs=1e-4)


ROOM = {"world": "rooms", "world_size": (8.0, 8.0), "slam": "truth", "control_hz": 5.0, "target_coverage": 0.9}


@pytest.mark.parametrize(
    ("id", "prior", "parts", "arguments", "reason"),
    [
        ("Explore", 20.0, {"trajectories": None, "plan": None}, ROOM, "covered"),
        (
            "Dock", 100.0, {"trajectories": {"fine": True}, "carrot": None, "goal": None},
            {"start": (12.0, -10.0, 2.0)}, "docked",
        ),
    ],
)  # fmt: skip
def test_an_untrained_network_with_a_prior_does_the_task(id, prior, parts, arguments, reason):
    """It explores along the plan, and docks by AMCL."""
    parts = parts | {"motion": None, "limits": None}
    env = gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic", observations=parts, **arguments)
    torch.manual_seed(0)
    network = TrajectoryNetwork(env.observation_space, width=8, hidden=8, prior=prior)
    observation, _ = env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        with torch.no_grad():
            logits, _ = network({name: torch.from_numpy(part)[None] for name, part in observation.items()})
        observation, _, terminated, truncated, info = env.step(network.twists[int(logits.argmax())].numpy())
    assert (info["end_reason"], info["collisions"]) == (reason, 0)


def test_a_policy_acts_by_twists_of_the_table():
    space, network = spaces.Dict(PARTS | {"goal": spaces.Box(-1.0, 1.0, (4,))}), {"width": 32, "hidden": 64}
    policy = TrajectoryPolicy(space, ACTIONS, ConstantSchedule(1e-3), network=network)
    seen = {name: value[0].numpy() for name, value in sample(policy.observation_space).items()}
    action, _ = policy.predict(seen, deterministic=True)
    assert (np.abs(TWISTS - action).max(axis=1) == 0).any()
