import math

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations import plan
from lidarnaut.envs.observations.plan import LOOKAHEADS, look_ahead
from lidarnaut.envs.tasks.explore import Explore
from tests.rooms import make_room

PARTS = ("scan", "motion", "plan")
ROOMS = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "control_hz": 5.0, "observations": PARTS}
CORRIDOR = make_room(0.0, 0.0, 12.0, 1.6, spawn=Pose2D(0.8, 0.8, 0.0))
"""At one end, all unknown space is at the other end."""


def test_points_ahead_are_measured_along_the_path():
    # 1 m along x, then along y; the robot is next to the first metre, and faces y.
    path = np.array([(0.05 * k, 0.0) for k in range(21)] + [(1.0, 0.05 * k) for k in range(1, 21)])
    out = np.empty(6, dtype=np.float32)
    nearest = look_ahead(path, 0, (0.5, -0.2, 0.5 * math.pi), LOOKAHEADS, out)
    assert nearest == 10
    # Points ahead are (0.8, 0), (1, 0.1) and (1, 1): seen from (0.5, -0.2), forward is y and left is -x.
    ahead = [(0.2, -0.3), (0.3, -0.5), (1.2, -0.5)]
    for (cosine, sine), (forward, left) in zip(out.reshape(3, 2), ahead, strict=True):
        assert (cosine, sine) == pytest.approx(np.array([forward, left]) / math.hypot(forward, left), abs=0.05)
    # Lookahead points beyond the end are the end.
    look_ahead(path, nearest, (1.0, 0.9, 0.0), LOOKAHEADS, out)
    assert out == pytest.approx([0.0, 1.0] * 3, abs=0.05)


@pytest.mark.parametrize("turn", [0.0, 0.5, -1.5, 3.0])
def test_the_plan_points_into_the_unknown_in_the_robots_frame(turn):
    settings = {"physics": "kinematic", "slam": "truth", "observations": ("plan",)}
    observation, _ = LidarEnv(Explore, world=CORRIDOR, start=(0.8, 0.8, turn), **settings).reset(seed=0)
    best = observation["plan"][:9]
    for direction in best[:6].reshape(3, 2):
        assert direction == pytest.approx([math.cos(-turn), math.sin(-turn)], abs=0.3)
    assert best[8] == 1.0
    assert 0.0 < best[6] < 1.0
    assert best[7] > 0.2


def rate_farthest():
    return lambda navigator, belief: navigator.candidates["cost"]


@pytest.mark.parametrize("rating", [rate_farthest, "tests.observations.test_plan:rate_farthest"])
def test_frontiers_are_ordered_by_a_rating_of_ones_own(rating):
    costs = []
    for part in ({}, {"rating": rating}):
        env = LidarEnv(Explore, **ROOMS | {"observations": {"plan": part}})
        rows = env.reset(seed=3)[0]["plan"].reshape(-1, 9)
        costs.append(rows[rows[:, 8] == 1.0, 6])
    assert len(costs[0]) >= 2
    assert (np.diff(costs[1]) <= 0).all()
    assert costs[1][0] > costs[0][0]
    env = LidarEnv(Explore, **ROOMS | {"observations": {"plan": {"rating": lambda: lambda navigator, belief: [1.0]}}})
    with pytest.raises(ValueError, match=r"rating of plan must return \d+ scores, got shape \(1,\)"):
        env.reset(seed=3)


def drive(env, steps, seed):
    observation, _ = env.reset(seed=seed)
    for _ in range(steps):
        yield observation
        cosine, sine = observation["plan"][:2].tolist()
        action = [max(cosine, 0.0) ** 2, min(max(0.8 * math.atan2(sine, cosine), -1.0), 1.0)]
        observation, _, terminated, truncated, info = env.step(np.array(action, dtype=np.float32))
        if terminated or truncated:
            assert info["end_reason"] == "covered"
            return


def test_who_follows_the_plan_explores_and_sees_it_change():
    env = LidarEnv(Explore, **ROOMS, target_coverage=0.9)
    seen = []
    for observation in drive(env, 2000, seed=0):
        assert env.observation_space.contains(observation)
        np.testing.assert_array_equal(env.observe()["plan"], observation["plan"])  # looking twice changes nothing
        seen.append(observation["plan"])
    assert env.task.coverage.explored_fraction >= 0.9
    assert (np.ptp(seen, axis=0)[:8] > 0.2).all()  # all numbers of the first path change
    rows = np.array(seen).reshape(-1, 9)
    present = rows[:, 8] == 1.0
    assert set(rows[:, 8]) <= {0.0, 1.0}
    assert not rows[~present].any()
    np.testing.assert_allclose(np.hypot(*rows[present, :6].reshape(-1, 2).T), 1.0, atol=1e-5)


def test_frontiers_are_found_anew_every_so_many_seconds(monkeypatch):
    def changes(detection_time):
        monkeypatch.setattr(plan, "DETECTION_TIME", detection_time)
        env = LidarEnv(Explore, **ROOMS | {"observations": ("plan",)})
        costs = [observation["plan"][6] for observation in drive(env, 100, seed=1)]
        return np.count_nonzero(np.diff(costs))

    often, seldom = changes(0.4), changes(4.0)
    assert often >= 40
    assert 3 <= seldom <= 25
