import contextlib

import numpy as np
import pytest

from lidarnaut.agents.frontiers import completion_training
from lidarnaut.agents.frontiers.completion import (
    BLOCKED,
    CELL,
    FREE,
    SIDE,
    UNKNOWN,
    Completion,
    CompletionNetwork,
    crop,
    expected_area,
)
from lidarnaut.agents.frontiers.completion_training import fit, samples_of
from lidarnaut.agents.frontiers.score import FrontierScore, ScoreExplorer
from lidarnaut.agents.frontiers.tasks import draw_task
from lidarnaut.agents.learned import find_policy, fingerprint, load_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.navigation.views import cast_view
from lidarnaut.envs.tasks.explore import Explore

MIDDLE = SIDE // 2


def corridor():
    """Known to the left of the middle; unknown to the right, where walls are 1 m above and below."""
    known, truth = np.full((2, SIDE, SIDE), BLOCKED, dtype=np.uint8)
    known[:, MIDDLE:] = UNKNOWN
    for cells in known[:, :MIDDLE], truth:
        cells[MIDDLE - 5 : MIDDLE + 5] = FREE
    return known, truth


def test_crops_show_what_is_known_around_a_point():
    joined = np.full((40, 40), -1, dtype=np.int8)
    joined[10:20, 10:20], joined[15, 15] = 0, 100
    out = np.empty((SIDE, SIDE), dtype=np.uint8)
    crop(joined, (-1.0, 2.0, 0.1), 0.5, 3.5, out)
    shown = out[MIDDLE - 4 : MIDDLE + 4, MIDDLE - 4 : MIDDLE + 4]
    expected = np.full((8, 8), UNKNOWN)
    expected[1:7, 1:7] = FREE  # 0.5 m in all directions: two and a half cells
    expected[4, 4] = BLOCKED
    np.testing.assert_array_equal(shown, expected)
    assert (out == BLOCKED).sum() == 1
    crop(joined, (90.0, 2.0, 0.1), 0.5, 3.5, out)
    assert (out == UNKNOWN).all()


def test_expected_areas_are_those_of_rays_where_nothing_is_blocked_and_what_is_there_where_all_is_known():
    known, truth = corridor()
    joined = np.choose(known, (-1, 0, 100)).astype(np.int8)
    unknown = np.empty(48)
    cast_view(joined, MIDDLE, MIDDLE, 30, np.empty(48), unknown)
    free = np.zeros((SIDE, SIDE), dtype=np.float32)
    assert expected_area(known, free, 30, 1.0) == pytest.approx(unknown.sum() * CELL**2, rel=0.1)
    assert expected_area(known, free + 1.0, 30, 1.0) == 0.0
    true = expected_area(known, (truth == BLOCKED).astype(np.float32), 30, 1.0)
    assert true == pytest.approx(30 * CELL * 2.0, rel=0.05)
    assert expected_area(known, free + 0.1, 30, 1.0) < expected_area(known, free + 0.1, 30, 0.5)


def test_samples_agree_with_what_is_known_where_something_is_known():
    samples = samples_of(draw_task(np.random.default_rng(5), ("rooms",)))
    known, truth = samples.swapaxes(0, 1)
    assert len(samples) > 10
    for value in FREE, BLOCKED:
        assert (truth[known == value] == value).mean() > 0.85
    assert 0.02 < (truth[known == UNKNOWN] == FREE).mean() < 0.9


def test_a_network_learns_how_corridors_go_on(monkeypatch, tmp_path):
    monkeypatch.setattr(completion_training, "BATCH", 16)
    known, truth = corridor()
    network = fit(np.array([[known, truth]] * 4), 150, np.random.default_rng(0))
    Completion(network).save(tmp_path, {"seed": "0"})
    blocked = Completion.load(tmp_path).blocked(known[None])[0]
    beyond = np.s_[MIDDLE - 12 : MIDDLE + 12, MIDDLE : MIDDLE + 12]
    assert ((blocked[beyond] > 0.5) == (truth[beyond] == BLOCKED)).mean() > 0.9
    assert expected_area(known, blocked, 30, 1.0) < 0.6 * expected_area(known, 0.0 * blocked, 30, 1.0)


def test_what_is_no_network_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="completes maps"):
        Completion.load(tmp_path)


def test_explorers_ask_for_completed_maps():
    estimates = []

    def estimate(navigator, table):
        Completion(CompletionNetwork())(navigator, table)
        estimates.append(table["visible"].copy())

    explorer = ScoreExplorer(FrontierScore(), estimate)
    with contextlib.closing(
        LidarEnv(Explore, physics="kinematic", slam="truth", world="rooms", time_limit=20.0)
    ) as env:
        run_episode(env, explorer, seed=0)
    assert len(estimates) > 2
    np.testing.assert_array_equal(explorer.navigator.candidates["visible"], estimates[-1])


def test_training_writes_a_policy_that_explores(tmp_path):
    score = find_policy("pretrained/frontiers")
    completion_training.main(tmp_path / "policy", tasks=1, steps=2, jobs=1)
    folder = find_policy(tmp_path / "policy")
    assert fingerprint(folder) != fingerprint(score)
    with contextlib.closing(LidarEnv(Explore, physics="kinematic", slam="truth", time_limit=10.0)) as env:
        areas = []
        for path in folder, score:
            explorer = load_policy(path)
            run_episode(env, explorer, seed=0)
            areas.append(explorer.navigator.candidates["visible"])
    assert not np.array_equal(*areas)
