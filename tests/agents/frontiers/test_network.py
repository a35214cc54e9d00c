import numpy as np
import pytest
import torch
from gymnasium import spaces

from lidarnaut.agents.algorithms import Actor
from lidarnaut.agents.frontiers.features import NUM_FEATURES, PRIOR
from lidarnaut.agents.frontiers.network import FrontierNetwork, FrontierPolicy
from lidarnaut.agents.frontiers.score import FrontierScore
from lidarnaut.envs.decisions.abstract import ExploreFrontiersAbstractEnv
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.frontiers.candidates import FAILURES

QUICK = {"world": "rooms", "world_size": (10.0, 10.0), "target_coverage": 0.95}


def batch_of(observations):
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}


def to_tensors(batch):
    return {key: torch.as_tensor(value) for key, value in batch.items()}


@pytest.fixture(scope="module")
def episode():
    """Return spaces, and observations and actions of an episode of the rule; failures are artificial."""
    env, rule = ExploreFrontiersAbstractEnv(**QUICK), GainOverCost()
    observations, choices = [], []
    observation, _ = env.reset(seed=4)
    for _ in range(40):
        if len(env.candidates):
            env.candidates["failures"][::4] = len(observations) % 3 == 0
            observation = env.observe()
            observations.append(observation)
            choices.append(rule(env.candidates, env.belief).argmax())
        observation, _, terminated, truncated, _ = env.step(np.int64(choices[-1] if choices else 0))
        if terminated or truncated:
            break
    return (env.observation_space, env.action_space), batch_of(observations), np.array(choices)


def make_policy(spaces_, trained=False, weights=None):
    torch.manual_seed(0)
    prior = {} if weights is None else {"prior_policy": "pretrained/frontiers"}
    policy = FrontierPolicy(*spaces_, lambda _: 1e-3, network={"width": 32, "heads": 4, "prior": 15.0, **prior})
    if weights is not None:
        policy.load_prior(FrontierScore(weights))
    if trained:
        torch.nn.init.normal_(policy.network.correct[-1].weight)
    return policy


def test_untrained_it_chooses_as_the_rule_or_the_score_that_it_starts_from(episode):
    spaces_, batch, choices = episode
    assert len(choices) > 20
    assert (batch["candidates"][:, :, FAILURES] > 0).any()
    np.testing.assert_array_equal(Actor(make_policy(spaces_))(batch), choices)
    assert (Actor(make_policy(spaces_, trained=True))(batch) != choices).any()
    weights = PRIOR + np.random.default_rng(0).normal(0.0, 0.5, NUM_FEATURES)
    score = FrontierScore(weights)
    expected = [score({key: value[i] for key, value in batch.items()}) for i in range(len(choices))]
    assert (expected != choices).any()
    np.testing.assert_array_equal(Actor(make_policy(spaces_, weights=weights))(batch), expected)


def test_the_network_sees_all_of_a_sample_whatever_its_order_and_nothing_of_the_others(episode):
    spaces_, batch, _ = episode
    network = make_policy(spaces_, trained=True).network

    def assert_close(changed, expected_logits, expected_values):
        logits, values = network(to_tensors(changed))
        assert torch.allclose(logits, expected_logits, atol=1e-3)
        assert torch.allclose(values, expected_values, atol=1e-5)

    order = np.random.default_rng(0).permutation(spaces_[1].n)
    permuted = {key: batch[key][:, order] for key in ("candidates", "sectors", "action_mask")}
    permuted["gaps"] = batch["gaps"][:, order][:, :, order]
    with torch.no_grad():
        logits, values = network(to_tensors(batch))
        assert values.std() > 1e-3
        assert_close(batch | permuted, logits[:, order], values)
        for one in (slice(0, 1), slice(-1, None)):
            assert_close({key: value[one] for key, value in batch.items()}, logits[one], values[one])
        # Attention depends on the distances between candidates.
        far, _ = network(to_tensors(batch | {"gaps": np.full_like(batch["gaps"], 0.9)}))
        assert (far - logits).abs().max() > 1e-3


def test_what_is_masked_is_never_drawn(episode):
    spaces_, batch, _ = episode
    torch.manual_seed(1)
    policy = make_policy(spaces_, trained=True)
    few = {key: value.copy() for key, value in batch.items()}
    few["action_mask"][:, 3:] = 0
    tensors = to_tensors(few)
    with torch.no_grad():
        drawn = torch.stack([policy(tensors)[0] for _ in range(50)])
    assert set(drawn.unique().tolist()) == {0, 1, 2}
    distribution = policy.get_distribution(tensors)
    assert (distribution.distribution.probs[:, 3:] == 0).all()
    assert torch.isfinite(distribution.entropy()).all()


def test_nothing_to_choose_from_is_no_error(episode):
    spaces_, batch, _ = episode
    policy = make_policy(spaces_, trained=True)
    nothing = {key: np.zeros_like(value[:2]) for key, value in batch.items()}
    values, log_prob, entropy = policy.evaluate_actions(to_tensors(nothing), torch.tensor([0, 5]))
    (values.mean() + log_prob.mean() + entropy.mean()).backward()
    gradients = [parameter.grad for parameter in policy.parameters() if parameter.grad is not None]
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_all_ways_through_the_policy_agree(episode):
    spaces_, batch, _ = episode
    policy, tensors = make_policy(spaces_, trained=True), to_tensors(batch)
    with torch.no_grad():
        actions, *expected = policy(tensors, deterministic=True)
        values, log_prob, _ = policy.evaluate_actions(tensors, actions)
        torch.testing.assert_close([values, log_prob], expected, atol=0.0, rtol=0.0)
        assert torch.equal(policy.predict_values(tensors), values)
        assert torch.equal(policy.get_distribution(tensors).mode(), actions)
    assert policy.predict({key: value[0] for key, value in batch.items()}, deterministic=True)[0] == actions[0]


def test_a_missing_observation_is_named():
    space = spaces.Dict({"scan": spaces.Box(0.0, 1.0, (4,), np.float32)})
    with pytest.raises(ValueError, match=r"frontier network requires .*lacks \['candidates', .*; it has \['scan'\]"):
        FrontierNetwork(space, width=8, heads=2, prior=1.0)
