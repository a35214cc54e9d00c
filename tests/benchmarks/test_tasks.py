import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines import policies_for
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs.files import read_record
from lidarnaut.envs.ids import arguments_of, find_spec
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.tasks.track import Track
from lidarnaut.evaluate_command import main, split_arguments
from tests.benchmarks.explorations import read_rows

ROOT = Path(__file__).parents[2]
BRIEF = ["--episodes", "1", "--physics", "kinematic", "--time-limit", "5"]
BEND = "[[-2.0, -0.5], [-0.55, -0.55], [-0.55, 0.55], [-2.0, 0.5]]"
TRACK = ["--arguments.path", BEND, "--arguments.map-resolution=0.05", "--worlds", "turtlebot3_world"]
CASES = {
    "Navigate": (Navigate, "pursuit", ["--worlds", "pimouse_arena", "--localizer", "truth"]),
    "Track": (Track, "route_follower", [*TRACK, "--robot", "turtlebot3_burger"]),
}


@pytest.mark.parametrize("id", CASES)
def test_a_classic_policy_and_random_are_compared_by_the_measures_of_the_task(id, tmp_path, no_overview):
    task, policy, options = CASES[id]
    command = ["--id", f"lidarnaut/{id}-v0", "--policies", policy, "random", *BRIEF, *options, "--out", str(tmp_path)]
    assert main(command) == 0
    rows = read_rows(tmp_path)
    own = [measure.name for measure in task.measures]
    key = ["policy", "world", "seed", "robot", "physics", "slam", "people", "model"]
    common = ["path_length", "collisions", "position_rmse", "heading_rmse", "decision_ms", "success"]
    ending = ["end_reason", "duration", "time_limit", "distance_limit"]
    assert list(rows[0]) == [*key, *own, *common, *ending]
    assert [row["policy"] for row in rows] == [policy, "random"]
    assert {row["slam"] for row in rows} == {"truth"} or id == "Track"
    headline = next(measure for measure in task.measures if measure.is_headline)
    page = (tmp_path / "leaderboard.md").read_text()
    assert f"Ordered by success, then by {headline.label}" in page
    for title in ("At a glance", "Leaderboard", "World by world", "Not finished"):
        assert f"## {title}" in page, title
    assert main(["--id", "lidarnaut/Explore-v0", "--policies", "frontier", *BRIEF, "--out", str(tmp_path)]) == 2


def test_arguments_of_the_environment_are_its_own(tmp_path, capsys):
    words = ["--arguments.goal_tolerance", "0.2", "--jobs", "2", "--arguments.split=train"]
    assert split_arguments(words) == (["--jobs", "2"], {"goal_tolerance": 0.2, "split": "train"})
    assert arguments_of("lidarnaut/ExploreTeam-v0")["num_robots"] == 2
    assert arguments_of("lidarnaut/ExploreHouse-v0")["world"] == "turtlebot3_house"
    assert find_spec("lidarnaut:lidarnaut/Track-v0").id == "lidarnaut/Track-v0"
    command = ["--id", "lidarnaut/Navigate-v0", "--policies", "random", *BRIEF, "--out", str(tmp_path)]
    assert main([*command, "--shard", "1/1"]) == 0
    assert main([*command, "--arguments.goal_tolerance", "0.2"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "holds an evaluation with arguments {}, not {'goal_tolerance': 0.2}" in said


def test_parameters_of_a_policy_and_of_its_navigator_are_set_by_name():
    policy = parse_policy("mine=tour?hysteresis=3,max_stops=8,max_time=.inf,inflation=0.2,view_distances=[0.0, 0.5]")
    assert policy.name == "mine"
    explorer = pickle.loads(pickle.dumps(policy)).make()
    params = explorer.rule._params
    assert (params.hysteresis, params.max_stops) == (3.0, 8)
    assert (explorer.max_time, explorer.planning.inflation) == (float("inf"), 0.2)
    assert list(explorer.planning.view_distances) == [0.0, 0.5]


def test_parameters_of_dwb_are_set_by_name():
    published = parse_policy("frontier:published?sim_time=1.2,stuck_time=20,cluster_tolerance=0.4").make()
    assert (published.dwb.sim_time, published.dwb.max_vel_x, published.params.stuck_time) == (1.2, 0.78, 20.0)
    assert published.rule._params.cluster_tolerance == 0.4
    env = gymnasium.make("lidarnaut/Navigate-v0", physics="kinematic")
    env.reset(seed=0)
    makers = policies_for(env)
    assert parse_policy("dwb:agv?vx_samples=5", makers).make().dwb.acc_lim_x == 4.0
    assert parse_policy("dwb?goal_tolerance=0.3,sim_time=2.5", makers).make().dwb.sim_time == 2.5
    for name, message in (
        ("dwb?sim_time=0", "sim_time: Input should be greater than 0, got 0"),
        ("dwb?sim_time=abc", "sim_time: Input should be a valid number"),
        ("dwb?sim_time=1000", "sim_time: Input should be less than or equal to 10"),
        ("dwb?sim_time=.inf", "sim_time: Input should be less than or equal to 10"),
        ("dwb?width=1e4", "width: Input should be less than or equal to 20"),
        ("dwb?max_recoveries=-1", "max_recoveries: Input should be greater than or equal to 0"),
        ("pursuit?sim_time=2.5", "unknown parameter 'sim_time'"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            parse_policy(name, makers)
        assert str(caught.value).startswith(f"policy '{name}': ")
        assert "\n" not in str(caught.value)
    for name, message in (
        ("frontier?max_goal_tolerance=-1", "max_goal_tolerance: Input should be greater than or equal to 0"),
        ("tour?max_tme=1", r"policy 'tour\?max_tme=1': unknown parameter 'max_tme' \(did you mean 'max_time'\?\)"),
        ("random?speed=1", "allowed are none"),
        ("nearest?max_time=fast", r"policy 'nearest\?max_time=fast': max_time must be a positive number"),
        ("tour?", "unknown policy"),
        ("ppo:pretrained/reach?determinstic=false", r"'determinstic' \(did you mean 'deterministic'\?\)"),
        ("ppo:pretrained/reach?deterministic=no way", "deterministic must be true or false, got 'no way'"),
    ):
        with pytest.raises(ValueError, match=message):
            parse_policy(name)


def test_learned_policies_draw_their_actions_if_asked():
    env = gymnasium.make("lidarnaut/ReachClutter-v0", **parse_policy("ppo:pretrained/reach").arguments)
    observation, _ = env.reset(seed=0)

    def actions(name, seed):
        policy = pickle.loads(pickle.dumps(parse_policy(f"ppo:pretrained/reach{name}"))).make()
        policy.reset(env.unwrapped.robot_params, env.unwrapped.control_period, np.random.default_rng(seed))
        return np.array([policy(observation) for _ in range(40)])

    drawn = actions("?deterministic=false", 1)
    assert len(np.unique(drawn, axis=0)) > 1
    np.testing.assert_array_equal(drawn, actions("?deterministic=false", 1))
    assert len(np.unique(actions("", 1), axis=0)) == 1


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "experiments").glob("*.yaml")), ids=lambda path: path.stem)
def test_experiments_have_policies_that_can_be_made(path):
    settings = read_record(path, Settings)
    env = gymnasium.make(settings.id, physics="kinematic")
    env.reset(seed=0)
    for name in settings.policies:
        parse_policy(name, policies_for(env))
