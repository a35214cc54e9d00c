import numpy as np
import pytest
import torch
from gymnasium import spaces

from lidarnaut.agents.networks import ExplorerFeatures, FlatFeatures, flat_space, flatten
from tests.agents.fake_env import observation_space


def sample(space, batch):
    rng = torch.Generator().manual_seed(0)
    return {key: torch.rand(batch, *box.shape, generator=rng) for key, box in space.spaces.items()}


@pytest.mark.parametrize("num_beams", [16, 37, 360, 640, 1081])
def test_any_number_of_beams_gives_the_promised_width(num_beams):
    space = observation_space(num_beams)
    features = ExplorerFeatures(space, features_dim=48)(sample(space, 5))
    assert features.shape == (5, 48)
    assert torch.isfinite(features).all()


def test_every_part_of_the_observation_reaches_the_features():
    space = observation_space(360)
    network = ExplorerFeatures(space)
    inputs = {key: value.requires_grad_() for key, value in sample(space, 8).items()}
    network.encode(inputs).square().sum().backward()
    for key in ("map_near", "map_far", "motion"):
        assert (inputs[key].grad.abs().sum(0) > 0).all(), f"a part of {key} is not looked at"
    plain = network({key: value.detach() for key, value in inputs.items()})
    for beam in range(0, 360, 17):
        scan = inputs["scan"].detach().clone()
        scan[:, beam] = 0.001
        changed = network({**{key: value.detach() for key, value in inputs.items()}, "scan": scan})
        assert not torch.equal(changed, plain), f"beam {beam} is not looked at"


def test_a_lost_beam_does_not_look_like_an_obstacle():
    space = observation_space(360)
    network = ExplorerFeatures(space)
    far = {key: torch.zeros(1, *box.shape) for key, box in space.spaces.items()}
    far["scan"] += 1.0
    lost, near = ({**far, "scan": far["scan"].clone()} for _ in range(2))
    lost["scan"][0, 100], near["scan"][0, 100] = 0.0, 1e-6
    assert not any(torch.equal(network(other), network(lost)) for other in (far, near))


def test_tables_crops_of_any_side_and_names_with_dots_are_read():
    shapes = {"map_near": (3, 24, 13), "maps": (2, 3, 20, 20)}
    parts = {name: spaces.Box(0, 255, shape, np.uint8) for name, shape in shapes.items()}
    parts |= {"mylab.parts:Route": spaces.Box(-1.0, 1.0, (10, 2)), "scan": spaces.Box(0.0, 1.0, (2, 36))}
    parts |= {"merge": spaces.Box(-1.0, 1.0, ()), "action_mask": spaces.MultiBinary(5)}
    space = spaces.Dict(parts)
    inputs = {key: value.requires_grad_() for key, value in sample(space, 3).items()}
    network = ExplorerFeatures(space, features_dim=8)
    features = network(inputs)
    assert features.shape == (3, 8)
    network.encode(inputs).square().sum().backward()
    assert all(value.grad.abs().sum() > 0 for value in inputs.values())
    flat = FlatFeatures(flat_space(space), parts=space, features_dim=8)
    flat.load_state_dict(network.state_dict())
    vectors = flatten({key: value.detach().numpy() for key, value in inputs.items()})
    torch.testing.assert_close(flat(torch.from_numpy(vectors)), features)
