import numpy as np
import pytest
import torch
from gymnasium import spaces

from agents.networks import ExplorerFeatures


def observation_space(num_beams=360, size=40):
    crop = spaces.Box(0, 255, (3, size, size), np.uint8)
    return spaces.Dict(
        {
            "scan": spaces.Box(0.0, 1.0, (num_beams,), np.float32),
            "map_near": crop,
            "map_far": crop,
            "motion": spaces.Box(-1.0, 1.0, (6,), np.float32),
        }
    )


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
    space = observation_space()
    network = ExplorerFeatures(space)
    inputs = {key: value.requires_grad_() for key, value in sample(space, 8).items()}
    network._encode(inputs).square().sum().backward()
    for key in ("map_near", "map_far", "motion"):
        assert (inputs[key].grad.abs().sum(0) > 0).all(), f"a part of {key} is not looked at"
    plain = network({key: value.detach() for key, value in inputs.items()})
    for beam in range(0, 360, 17):
        scan = inputs["scan"].detach().clone()
        scan[:, beam] = 0.001
        changed = network({**{key: value.detach() for key, value in inputs.items()}, "scan": scan})
        assert not torch.equal(changed, plain), f"beam {beam} is not looked at"


def test_map_crops_may_be_missing_and_vectors_may_be_added():
    plan = spaces.Box(-1.0, 1.0, (27,), np.float32)
    for parts in ({}, {"map_near": observation_space()["map_near"]}):
        space = spaces.Dict({**{key: observation_space()[key] for key in ("scan", "motion")}, **parts, "plan": plan})
        network = ExplorerFeatures(space)
        inputs = sample(space, 8)
        inputs["plan"].requires_grad_()
        network._encode(inputs).square().sum().backward()
        assert (inputs["plan"].grad.abs().sum(0) > 0).all()


def test_a_lost_beam_does_not_look_like_an_obstacle():
    space = observation_space()
    network = ExplorerFeatures(space)
    far = {key: torch.zeros(1, *box.shape) for key, box in space.spaces.items()}
    far["scan"] += 1.0
    lost, near = dict(far), dict(far)
    lost["scan"], near["scan"] = far["scan"].clone(), far["scan"].clone()
    lost["scan"][0, 100] = 0.0
    near["scan"][0, 100] = 1e-6
    parts = [network.nearest((1.0 - scan["scan"]) * (scan["scan"] > 0)) for scan in (far, lost, near)]
    assert torch.equal(parts[0], parts[1])
    assert parts[2].max() > 0.99
    assert not torch.equal(network(far), network(lost))
    assert not torch.equal(network(near), network(lost))


def test_unsuitable_spaces_are_refused():
    with pytest.raises(ValueError, match=r"lacks \['motion'\]"):
        ExplorerFeatures(spaces.Dict({key: observation_space()[key] for key in ("scan", "map_near")}))
    with pytest.raises(ValueError, match=r"neither are \['route \(10, 2\)'\]"):
        ExplorerFeatures(spaces.Dict({**observation_space().spaces, "route": spaces.Box(-1.0, 1.0, (10, 2))}))
    with pytest.raises(ValueError, match=r"map crops must have shape .* got \(3, 24, 24\)"):
        ExplorerFeatures(observation_space(size=24))
