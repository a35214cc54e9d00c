import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence as same

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief, MapUpdate
from lidarnaut.envs.geometry import ORIGIN, Pose2D, Window
from lidarnaut.envs.observations import MapCrop
from lidarnaut.envs.slam import KnownPoses, load_params
from lidarnaut.envs.task import Rewards
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.worlds import load_world
from tests.rollouts import rollout

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0}
STILL = np.zeros(2, dtype=np.float32)


class Speed:
    def space(self, robot):
        return spaces.Box(-1.0, 1.0, (1,), np.float32)

    def write(self, robot, out):
        out[0] = robot.twist.v / robot.params.max_v


class Own(KnownPoses):
    """SLAM that maps at given poses."""

    def __init__(self, lidar, resolution):
        super().__init__(lidar, load_params("default", {"resolution": resolution}))


class Nailed(Own):
    """SLAM that keeps the start pose."""

    def update(self, reading, motion):
        return super().update(reading, type(motion)(0.0, 0.0, 0.0))


class Hurry(Rewards):
    changes = {"hurry": -1.0}

    def terms(self, quantities):
        return super().terms({**quantities, "hurry": quantities["time"]})


class Beacon:
    name = "beacon"
    shape = (1,)

    def reset(self, world, rng):
        self._rng = rng

    def measure(self, simulator, robot):
        return np.hypot(*simulator.states[robot].pose[:2]) + 0.1 * self._rng.standard_normal(1)


class Cliff(Beacon):
    name = "cliff"

    def measure(self, simulator, robot):
        return np.array([float(robot)])


def test_world_and_start_can_be_chosen_for_one_episode():
    env = LidarEnv(Explore, **{**QUICK, "world_size": None})
    first = rollout(env, 3, 10)
    env.reset(seed=3, options={"world": "turtlebot3_world", "start": (-2.0, 0.5, 1.0)})
    assert env.world.name == "turtlebot3_world"
    assert tuple(env.map_pose) == (-2.0, 0.5, 1.0)
    env.reset(options={"world": load_world("turtlebot3_stage_1"), "start": "spawn"})
    assert env.world.name == "turtlebot3_stage_1"
    assert same(first, rollout(env, 3, 10))


WRONG_OPTIONS = {"start": "home"}, {"world": "atlantis"}, {"start": (99.0, 0.0, 0.0)}


@pytest.mark.parametrize("options", WRONG_OPTIONS)
def test_options_that_are_not_allowed_are_named_and_begin_no_episode(options):
    env = LidarEnv(Explore, **QUICK, slam="truth")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"unknown options \['weather'\]; allowed are .*'start'"):
        env.reset(options={**options, "weather": "rain"})
    env.step(STILL)
    with pytest.raises(ValueError, match=next(iter(options))):
        env.reset(options=options)
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episode has begun"):
        env.step(STILL)
    env.reset()
    env.step(STILL)


def test_a_prepared_world_is_the_one_that_would_have_been_drawn():
    prepared, plain = LidarEnv(Explore, **QUICK), LidarEnv(Explore, **QUICK)
    for env in (prepared, plain):
        env.reset(seed=0)
    for options in (None, {"world": "turtlebot3_world"}, None):
        prepared.prepare()
        assert same(prepared.reset(options=options), plain.reset(options=options))


def test_observations_are_chosen_by_name_and_argument():
    env = LidarEnv(Explore, **QUICK, observations=("motion", "map_far"))
    assert list(env.reset(seed=0)[0]) == list(env.observation_space) == ["map_far", "motion"]
    parts = {"scan": None, "map_near": {"resolution": 0.1, "size": 64}, "wide": MapCrop(0.4, size=48)}
    env = LidarEnv(Explore, **QUICK, observations=parts)
    observation, _ = env.reset(seed=0)
    shapes = {key: part.shape for key, part in observation.items()}
    assert shapes == {"scan": (360,), "map_near": (3, 64, 64), "wide": (3, 48, 48)}
    assert observation in env.observation_space
    usual = LidarEnv(Explore, **QUICK)
    expected = usual.reset(seed=0)[0]
    np.testing.assert_array_equal(observation["scan"], expected["scan"])
    # 64 pixels of 0.1 m are equal to the inner 32 pixels of 0.2 m.
    fine = observation["map_near"][1].reshape(32, 2, 32, 2).mean(axis=(1, 3))
    assert np.abs(fine - expected["map_near"][1, 4:36, 4:36]).mean() < 25.0


def test_parts_rewards_and_slams_of_the_users_own_code():
    own = {"observations": {"speed": f"{__name__}:Speed", "motion": None}, "reward": f"{__name__}:Hurry"}
    env = gymnasium.make("lidarnaut/Explore-v0", **QUICK, **own, slam=f"{__name__}:Nailed")
    env.reset(seed=0)
    for _ in range(5):
        observation, reward, _, _, info = env.step(np.array([1.0, 0.0], dtype=np.float32))
    assert observation["speed"][0] == pytest.approx(observation["motion"][0])
    assert observation["speed"][0] > 0.3
    assert info["rewards"]["hurry"] == pytest.approx(-0.2 * 0.2)  # a rate, times the period
    assert reward == pytest.approx(sum(info["rewards"].values()))
    assert info["pose_error"][0] == pytest.approx(info["path_length"], abs=0.02)


def test_a_slam_can_be_given_as_an_object_and_is_copied():
    robot = LidarEnv(Explore, **QUICK).robot_params
    slam = KnownPoses(robot.lidar, load_params("default", {"resolution": 0.05}))
    first, second = LidarEnv(Explore, **QUICK, slam=slam), LidarEnv(Explore, **QUICK, slam=slam)
    assert same(rollout(first, 1, 10), rollout(second, 1, 10))
    first.reset(seed=1)
    assert first.belief is not second.belief
    with pytest.raises(ValueError, match="slam must be"):
        LidarEnv(Explore, **QUICK, slam=7)


def test_a_slam_that_cannot_share_its_map_is_refused_for_teams():
    class Unshared(Own):
        shares_maps = False

    LidarEnv(ExploreTeam, **QUICK, slam=Unshared, num_robots=1).reset(seed=0)
    for slam in (Unshared, "graph", "gmapping"):
        with pytest.raises(ValueError, match="cannot share a map; choose hector, tinyslam, odometry or truth"):
            LidarEnv(ExploreTeam, **QUICK, slam=slam, num_robots=2)


class Redrawing(Own):
    """Moves its whole map by a metre at the tenth scan, like a loop closure."""

    def reset(self, rng, pose=ORIGIN, map=None):
        self._count = 0
        return super().reset(rng, pose, map)

    def update(self, reading, motion) -> Belief:
        belief = super().update(reading, motion)
        self._count += 1
        if self._count == 10:
            cells = round(1.0 / belief.grid.resolution)
            belief.grid.data[:] = np.roll(belief.grid.data, cells, axis=1)
            known = np.argwhere(belief.grid.data >= 0).astype(np.int32)
            window = Window(0, 0, *belief.grid.data.shape)
            belief.update = MapUpdate(known, window, redrawn=True, origin=belief.grid.origin)
            belief.pose = belief.pose._replace(x=belief.pose.x + 1.0)
            belief.path = np.array([[1.0, 0.0, 0.0], [*belief.pose]])
        return belief


def test_a_map_that_is_redrawn_reaches_coverage_crops_and_trail():
    env = LidarEnv(Explore, **QUICK, slam=Redrawing, target_coverage=1.0)
    env.reset(seed=2)
    ahead = np.array([0.4, 0.1], dtype=np.float32)
    infos = [env.step(ahead)[4] for _ in range(8)]
    before, crop = infos[-1]["explored_area"], env.observe()["map_near"]
    _, _, _, _, info = env.step(ahead)
    # Cells at the true positions are no longer known.
    assert info["explored_area"] < 0.95 * before
    assert info["rewards"]["explored"] == pytest.approx(info["explored_area"] - before)
    assert env.robots[0].trail.positions[0].tolist() == [1.0, 0.0]
    assert np.mean(env.observe()["map_near"][:2] != crop[:2]) < 0.2


def test_actions_outside_are_refused_or_clipped():
    env, clipped = LidarEnv(Explore, **QUICK), LidarEnv(Explore, **QUICK, clip_actions=True)
    for each in (env, clipped):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=r"action must.*, got \[1.5 0. \]; clip_actions=True clips"):
        env.step(np.array([1.5, 0.0], dtype=np.float32))
    for each in (env, clipped):
        with pytest.raises(ValueError, match=r"action must.*, got \[nan  2.\]$"):
            each.step(np.array([np.nan, 2.0], dtype=np.float32))
    expected = env.step(np.array([1.0, -1.0], dtype=np.float32))
    assert same(clipped.step(np.array([2.5, -7.0], dtype=np.float32)), expected)


def test_rewards_name_what_is_wrong():
    weights = {"explored": 1.0, "time": -0.1}
    assert Rewards.of(weights, {"explored": 2.0}).weights == {"explored": 2.0, "time": -0.1}
    for reward in ({"class": Hurry, "time": -5.0}, {"class": f"{__name__}:Hurry", "time": -5.0}):
        rewards = Rewards.of(weights, reward)
        assert (type(rewards).__name__, rewards.weights) == ("Hurry", {"explored": 1.0, "time": -5.0, "hurry": -1.0})
    for wrong in ({"fame": 1.0}, {"time": np.nan}, 5, {"class": 5}):
        with pytest.raises(ValueError, match=r"fame|time|reward must map"):
            Rewards.of(weights, wrong)


def test_copies_of_bullets_made_in_mid_episode_say_that_they_cannot_go_on():
    pytest.importorskip("pybullet")
    env = LidarEnv(Explore, **QUICK | {"physics": "bullet"}, slam="truth")
    env.reset(seed=0)
    for copy in (first := pickle.loads(pickle.dumps(env)), pickle.loads(pickle.dumps(first))):
        with pytest.raises(gymnasium.error.ResetNeeded, match="cannot be copied in mid-episode"):
            copy.step(STILL)
        copy.reset(seed=0)
        copy.step(STILL)
        copy.close()
    env.close()


@pytest.mark.parametrize("robot", ["turtlebot3_burger", "raspimouse"])
@pytest.mark.parametrize("slam", ["odometry", "truth"])
def test_a_row_holds_what_readings_and_states_come_to(slam, robot):
    """Kernels of a control period, compared with the equivalent Python classes."""
    env = LidarEnv(Explore, slam=slam, **{**QUICK, "robot": robot})
    env.reset(seed=2)
    one, truth = env.robots[0], env.truths[0]
    pose, true_pose, length, contacts, was_touched = Pose2D(0.0, 0.0, 0.0), truth.state.pose, 0.0, 0, False
    positions = [true_pose[:2]]
    rng = np.random.default_rng(1)
    for _ in range(40):
        env.step(rng.uniform((0.3, -0.5), (1.0, 0.5)).astype(np.float32))
        before, true_pose = true_pose, truth.state.pose
        motion = before.between(true_pose) if slam == "truth" else env.reading.motion
        pose = pose.compose(motion)
        length += float(np.sqrt((true_pose.x - before.x) ** 2 + (true_pose.y - before.y) ** 2))
        contacts += env.reading.bumper and not was_touched
        was_touched = env.reading.bumper
        if np.hypot(*np.subtract(true_pose[:2], positions[-1])) >= 0.1:
            positions.append(true_pose[:2])
        assert one.motion == motion
        assert one.belief.pose == one.predicted_pose == pose
        assert one.twist == (env.reading.motion.x / env.control_period, env.reading.motion.theta / env.control_period)
        assert (one.collisions, one.bumper) == (contacts, was_touched)
        assert truth.path_length == pytest.approx(length, abs=1e-12)
        np.testing.assert_array_equal(truth.trail.positions, positions)
    assert len(positions) > 5


def measured(env, steps=10):
    """Return the measurements of all robots in each step."""
    env.reset(seed=1)
    seen = []
    for _ in range(steps):
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        seen.append([dict(robot.reading.extra) for robot in env.robots])
    return seen


def test_readings_hold_what_sensors_measure_and_the_same_seed_repeats_it_also_in_copies():
    sensors = [Beacon(), "tests.test_core:Cliff"]
    env, other = (LidarEnv(Explore, sensors=sensors, **QUICK) for _ in range(2))
    assert env.sensors[0] is not sensors[0]
    first = measured(env)
    assert first == measured(pickle.loads(pickle.dumps(other)))
    assert set(first[0][0]) == {"beacon", "cliff"}
    assert len({float(step[0]["beacon"][0]) for step in first}) == 10
    assert same(env.reset(seed=4)[0], LidarEnv(Explore, **QUICK).reset(seed=4)[0])  # as without sensors


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_each_robot_of_a_team_has_its_own_measurement(physics):
    env = LidarEnv(ExploreTeam, sensors=[Cliff], **{**QUICK, "physics": physics})
    assert [one["cliff"].tolist() for one in measured(env, 1)[0]] == [[0.0], [1.0]]
    env.close()


@pytest.mark.parametrize(
    ("sensors", "culprit"),
    [
        ("beacon", "sensors must be a sequence"),
        ([Beacon, Beacon], "unique names"),
        ([object()], "lacks name, shape, reset, measure"),
        (["nowhere"], "unknown sensor 'nowhere'"),
    ],
)
def test_what_is_no_sensor_is_named(sensors, culprit):
    with pytest.raises(ValueError, match=culprit):
        LidarEnv(Explore, sensors=sensors, **QUICK)


class Device(Cliff):
    name = "device"
    has_failed = False

    def reset(self, world, rng):
        self.count = 0

    def measure(self, simulator, robot):
        self.count += 1
        if self.count == 4 and not self.has_failed:
            self.has_failed = True
            raise RuntimeError("no answer")
        return np.array([1.0])


class Failing(Rewards):
    count = 0

    def terms(self, quantities):
        self.count += 1
        if self.count == 3:
            raise RuntimeError("no answer")
        return super().terms(quantities)


class Mute(Speed):
    count = 0

    def write(self, robot, out):
        self.count += 1
        if self.count == 4:
            raise RuntimeError("no answer")
        super().write(robot, out)


FAILURES = {
    "sensor": ("Explore", {"sensors": [Device()]}),
    "reward": ("Explore", {"reward": Failing}),
    "part": ("Explore", {"observations": {"mute": Mute}}),
    "decisions": ("ExploreFrontiers", {"sensors": [Device()]}),
    "team of decisions": ("ExploreTeamFrontiers", {"sensors": [Device()]}),
}


@pytest.mark.parametrize("case", FAILURES)
def test_after_an_error_in_a_step_a_reset_is_asked_for(case):
    id, arguments = FAILURES[case]
    env = gymnasium.make(f"lidarnaut/{id}-v0", **QUICK, **arguments, disable_env_checker=True)
    first, _ = env.reset(seed=1)
    action = env.action_space.sample()
    with pytest.raises(RuntimeError, match="no answer"):
        [env.step(action) for _ in range(5)]
    for _ in range(2):
        with pytest.raises(gymnasium.error.ResetNeeded, match="or a step has failed"):
            env.step(action)
    assert same(env.reset(seed=1)[0], first)
    env.step(action)


def test_after_an_action_that_is_refused_the_episode_goes_on():
    env, other = LidarEnv(Explore, **QUICK), LidarEnv(Explore, **QUICK)
    for each in (env, other):
        each.reset(seed=1)
    with pytest.raises(ValueError, match="action must"):
        env.step(np.full(2, 2.0))
    assert same(env.step(STILL), other.step(STILL))


@pytest.mark.parametrize("id", ["Explore", "ExploreFrontiers", "ExploreTeamFrontiers", "Track"])
def test_unknown_arguments_are_named_in_pythons_words_with_a_hint(id):
    says = "got an unexpected keyword argument 'frameskip'; allowed are .*'?control_hz"
    with pytest.raises(TypeError, match=says):
        gymnasium.make(f"lidarnaut/{id}-v0", frameskip=1)
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'wrld' \(did you mean 'world'\?\)"):
        gymnasium.make(f"lidarnaut/{id}-v0", wrld="rooms")
