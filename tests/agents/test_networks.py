import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch.nn import functional

from lidarnaut.agents.networks import ExplorerFeatures, FlatFeatures, ScanWindows, flat_space, flatten
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
    parts = {
        "map_near": spaces.Box(0, 255, (3, 24, 13), np.uint8),
        "maps": spaces.Box(0, 255, (2, 3, 20, 20), np.uint8),
        "mylab.parts:Route": spaces.Box(-1.0, 1.0, (10, 2)),
        "scan": spaces.Box(0.0, 1.0, (2, 36)),
        "merge": spaces.Box(-1.0, 1.0, ()),
        "action_mask": spaces.MultiBinary(5),
    }
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


def test_windows_of_scans_are_a_convolution_beside_all_other_parts():
    space = spaces.Dict({"scan_history": spaces.Box(0, 1, (36,)), "goal": spaces.Box(-1, 1, (4,))})
    network = ScanWindows(space, num_sectors=12, width=4, stride=2, channels=5)
    inputs = sample(space, 7)
    features = network(inputs)
    assert features.shape == (7, network.features_dim)
    layer = network.window[0]
    scans = inputs["scan_history"].reshape(7, 3, 12).clone()
    scans[:, 1:] = 4.0 * (scans[:, :1] - scans[:, 1:])
    expected = functional.conv1d(scans, layer.weight.reshape(5, 3, 4), layer.bias, stride=2).relu()
    torch.testing.assert_close(features[:, :25].reshape(7, 5, 5), expected.transpose(1, 2))
    assert torch.equal(features[:, 25:], inputs["goal"])


@pytest.mark.parametrize("wrong", [{"key": "scan"}, {"num_sectors": 7}, {"num_sectors": 9, "width": 10}])
def test_windows_that_do_not_fit_the_scans_are_refused(wrong):
    space = spaces.Dict({"scan_history": spaces.Box(0, 1, (36,))})
    with pytest.raises(ValueError, match=r"ScanWindows needs scans of \d+ sectors"):
        ScanWindows(space, **({"num_sectors": 12} | wrong))


def test_windows_of_scans_look_at_the_names_of_parts_and_not_at_their_order():
    space = spaces.Dict(
        {name: spaces.Box(-1, 1, (width,)) for name, width in (("goal", 4), ("limits", 3), ("scan_history", 36))}
    )
    network = ScanWindows(space, num_sectors=12, width=4, stride=2)
    inputs = sample(space, 2)
    assert torch.equal(network(inputs), network(dict(reversed(inputs.items()))))
