"""Rewards of one's own: shared quantities, weights, and what is wrong with them."""

import math

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs import task
from lidarnaut.envs.task import SHARED_QUANTITIES, Rewards

CROWD = {"world": "rooms", "people": 6, "physics": "kinematic"}
WEIGHTS = dict.fromkeys(SHARED_QUANTITIES, 0.1)


class Notes(Rewards):
    """Keeps the shared quantities of each step, and rewards nothing of its own."""

    def terms(self, quantities):
        self.seen = {name: quantities[name] for name in SHARED_QUANTITIES}
        return super().terms(quantities)


class Smooth(Rewards):
    """Own term of speed and gap beside weights of the task and of a shared quantity."""

    changes = {"jerk": -0.001, "hurry": 1.0}

    def terms(self, quantities):
        hurry = np.sum(quantities["forward_speed"] * (quantities["obstacle_gap"] > 0.2))
        return super().terms({**quantities, "hurry": float(hurry)})


class Plain(Rewards):
    """Reads quantities of the task only."""

    def terms(self, quantities):
        return super().terms({**quantities})


def to_nearest(position, segments, circles):
    """Return the distance of a position to the nearest segment or circle [m], by dense samples of the segments."""
    along = np.linspace(0.0, 1.0, 2001)[:, None, None]
    points = segments[:, :2] + along * (segments[:, 2:] - segments[:, :2])
    gaps = [np.linalg.norm(points - position, axis=2).min()]
    gaps += [np.hypot(*(circle[:2] - position)) - circle[2] for circle in circles]
    return min(gaps)


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_shared_quantities_are_true_values_at_the_end_of_the_step(physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    env = gymnasium.make("lidarnaut/ReachGoal-v0", **{**CROWD, "physics": physics}, reward=Notes, contact="costs")
    env.reset(seed=1)
    inner, period = env.unwrapped, env.unwrapped.control_period
    rng, speeds = np.random.default_rng(0), [0.0, 0.0]
    varied = []
    for _ in range(25):
        action = rng.uniform(-0.2, 1.0, 2).astype(np.float32)
        *_, info = env.step(action)
        seen, state = inner.task.rewards.seen, inner.truths[0].state
        varied.append(list(seen.values()))
        assert all(type(value) is float for value in seen.values())
        assert (seen["forward_speed"], seen["yaw_rate"]) == state.twist
        assert (seen["action_v"], seen["action_w"]) == tuple(action.tolist())
        assert [seen["position_error"], seen["yaw_error"]] == info["pose_error"].tolist()
        speeds.append(inner.rows.numbers["commanded_v"][0])
        accelerations = np.diff(speeds) / period
        assert seen["acceleration"] == pytest.approx(accelerations[-1], abs=1e-9)
        assert seen["jerk"] == pytest.approx(abs(accelerations[-1] - accelerations[-2]) / period, abs=1e-6)
        x, y, _ = state.pose
        away = to_nearest((x, y), inner.world.segments, inner.world.circles) - inner.robot_params.radius
        assert seen["obstacle_gap"] == pytest.approx(min(max(away, 0.0), 10.0), abs=2e-3)
        people = inner.simulator.people
        nearest = min(np.hypot(px - x, py - y) - radius for px, py, _, _, radius in people)
        assert seen["person_gap"] == pytest.approx(min(nearest - inner.robot_params.radius, 10.0), abs=1e-6)
    assert (np.ptp(varied, axis=0) > 0.0).all()


def test_terms_of_a_team_are_sums_over_its_robots():
    env = gymnasium.make("lidarnaut/ExploreTeam-v0", num_robots=3, physics="kinematic", reward=Notes)
    weighted = gymnasium.make("lidarnaut/ExploreTeam-v0", num_robots=3, physics="kinematic", reward=WEIGHTS)
    action = np.array([[1.0, 0.2], [-1.0, 0.0], [0.0, -1.0]], dtype=np.float32)
    for each in (env, weighted):
        each.reset(seed=3)
    for _ in range(5):
        env.step(action)
        *_, info = weighted.step(action)
    seen, inner = env.unwrapped.task.rewards.seen, env.unwrapped
    for name in SHARED_QUANTITIES:
        assert seen[name].shape == (3,)
        expected = seen[name].sum() if name == "forward_speed" else np.abs(seen[name]).sum()
        assert info["rewards"][name] == pytest.approx(0.1 * inner.control_period * expected)
    poses = np.array([state.pose[:2] for state in inner.simulator.states])
    apart = np.linalg.norm(poses[:, None] - poses, axis=2) + 100.0 * np.eye(3)
    assert (seen["obstacle_gap"] <= apart.min(axis=1) - 2.0 * inner.robot_params.radius + 1e-9).all()


@pytest.mark.parametrize("id", ["ExploreFrontiers-v0", "ExploreTeamFrontiers-v0"])
def test_terms_of_a_decision_are_sums_over_its_control_periods(id):
    arguments = {"world": "turtlebot3_house", "slam": "odometry", "physics": "kinematic"}
    env = gymnasium.make(f"lidarnaut/{id}", **arguments, reward={"yaw_rate": -1.0, "forward_speed": 2.0})
    env.reset(seed=0)
    inner, sums = env.unwrapped.explore, np.zeros(2)

    def watch(twists):
        v, w = inner.rows.numbers["v"].sum(), np.abs(inner.rows.numbers["w"]).sum()
        sums[:] += inner.control_period * np.array([-w, 2.0 * v])

    inner.on_period = watch
    steps = 0
    for _ in range(6):
        sums[:] = 0.0
        *_, info = env.step(np.int64(0))
        assert info["rewards"]["yaw_rate"] == pytest.approx(sums[0])
        assert info["rewards"]["forward_speed"] == pytest.approx(sums[1])
        steps += info["decision_steps"]
    assert steps > 20
    assert not env.unwrapped.is_fused


def test_quantities_that_no_reward_reads_are_not_computed(monkeypatch):
    def fail(*_):
        raise AssertionError("not read")

    monkeypatch.setattr(task, "clearance", fail)
    for reward in (None, Plain, {"yaw_rate": -0.1}):
        env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", reward=reward)
        env.reset(seed=0)
        env.step(np.zeros(2, dtype=np.float32))
    env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", reward=Smooth)
    env.reset(seed=0)
    with pytest.raises(AssertionError, match="not read"):
        env.step(np.zeros(2, dtype=np.float32))


class Own(Rewards):
    """Own terms with and without a weight, as rates and as amounts of a step."""

    changes = {"rate": -2.0, "amount": 3.0, "collision": -7.0}
    per_step = ("amount", "other_amount")

    def terms(self, quantities):
        own = {"rate": 0.5, "amount": 0.5}
        return super().terms({**quantities, **own}) | {"other_rate": 4.0, "other_amount": 4.0}


@pytest.mark.parametrize(
    ("id", "arguments", "control_hz"),
    [
        ("ReachGoal", {}, 4.0),
        ("ReachGoal", {"num_envs": 2}, 4.0),
        ("ExploreFrontiers", {}, 10.0),
        ("ExploreTeam", {}, 10.0),
    ],
)
def test_own_terms_are_rates_unless_they_are_amounts_of_a_step(id, arguments, control_hz):
    """Terms of the task are the same with and without the class."""
    outcomes = []
    for reward in (Own, {"collision": -7.0}):
        make = gymnasium.make_vec if arguments else gymnasium.make
        env = make(f"lidarnaut/{id}-v0", **arguments, physics="kinematic", control_hz=control_hz, reward=reward)
        env.reset(seed=0)
        *_, info = env.step(np.zeros(env.action_space.shape, env.action_space.dtype)[()])
        outcomes.append((info["rewards"], info.get("decision_time", 1.0 / control_hz), info.get("decision_steps", 1)))
    (rewards, duration, steps), (usual, *_) = outcomes
    expected = {"rate": -duration, "other_rate": 4.0 * duration, "amount": 1.5 * steps, "other_amount": 4.0 * steps}
    for name, value in expected.items():
        np.testing.assert_allclose(rewards.pop(name), value, rtol=1e-9)
    for name in usual:
        np.testing.assert_allclose(rewards[name], usual[name], rtol=1e-12)  # decisions may add up in another order


def returning(terms):
    """Return a class of rewards whose terms are `terms(quantities)`."""
    return type("Mine", (Rewards,), {"terms": lambda self, quantities: terms(quantities)})


WRONG = {
    "unknown quantity": (lambda q: {"fast": q["speed"]}, r"unknown quantity 'speed' \(did you mean .*forward_speed"),
    "NaN": (lambda q: {"time": 0.1, "fast": math.nan}, r"reward Mine must return finite numbers .* \{'fast': nan\}"),
    "None": (lambda q: {"fast": None, "time": 1.0}, r"reward Mine .*\{'fast': None\}"),
    "text": (lambda q: {"fast": "1"}, r"reward Mine .*\{'fast': '1'\}"),
    "array": (lambda q: {"fast": np.ones(1)}, r"reward Mine .*\{'fast': array"),
    "number": (lambda q: 0.5, r"reward Mine must return finite numbers by name, got 0.5"),
    "nothing": (lambda q: None, r"reward Mine must return finite numbers by name, got None"),
}


@pytest.mark.parametrize("is_vector", [False, True])
def test_a_wrong_term_is_named(is_vector):
    more = {"num_envs": 2, "num_workers": 0} if is_vector else {"disable_env_checker": True}
    make = gymnasium.make_vec if is_vector else gymnasium.make
    for terms, message in WRONG.values():
        env = make("lidarnaut/ReachGoal-v0", **more, physics="kinematic", reward=returning(terms))
        env.reset(seed=0)
        with pytest.raises(ValueError, match=message) as error:
            env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        assert "speed" not in message or all(name in str(error.value) for name in ("people", *SHARED_QUANTITIES))


class Lacking(Rewards):
    changes = {"carefull": 1.0}

    def terms(self, quantities):
        return super().terms({**quantities, "careful": 1.0})


def test_unknown_weights_and_weights_without_a_quantity_are_named():
    for reward in ({"yawrate": -0.1}, type("Typo", (Rewards,), {"changes": {"yawrate": -0.1}})):
        with pytest.raises(ValueError, match=r"unknown terms \['yawrate'\]; allowed are .*'explored'.*'yaw_rate'"):
            gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", reward=reward)
    env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", reward=Lacking)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"reward has no quantity 'carefull' .did you mean 'careful'.*explored"):
        env.step(np.zeros(2, dtype=np.float32))
