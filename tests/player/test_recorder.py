import io

import gymnasium
import numpy as np
import pytest

from lidarnaut.agents.completion.completion import Completion
from lidarnaut.agents.completion.explorer import ForesightExplorer
from lidarnaut.agents.completion.network import CompletionNetwork
from lidarnaut.agents.frontiers.score import FrontierScore, ScoreExplorer
from lidarnaut.baselines import RrtExplorer, policies_for
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.expected_map import Prediction
from lidarnaut.baselines.frontier.rules import GainOverCostExplorer, NearestExplorer
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import Markers, crop_to_known
from lidarnaut.envs.player import EpisodeRecorder, Recording, build_page
from lidarnaut.envs.player.recorder import PLAN_TOLERANCE, MapHistory, corners, marker_rows
from lidarnaut.envs.player.recording import BODY_KINDS
from lidarnaut.envs.simulation.crowd.person_row import ATTENTIVE, BLIND, FIXED_ROUTE, KIND, STANDING
from tests.player.episodes import synthetic

BEND = [[-2.0, -0.5], [-0.55, -0.55], [-0.55, 0.55], [-2.0, 0.5]]


def make_env(id="lidarnaut/Explore-v0", **arguments):
    arguments = {"world": "turtlebot3_world", "physics": "kinematic", "time_limit": 12.0} | arguments
    return gymnasium.make(id, disable_env_checker=True, **arguments)


def record(env, explorer, seed=0):
    seen = []

    def watch(info):
        inner = getattr(env.unwrapped, "explore", env.unwrapped)
        pose = inner.truths[0].state.pose
        seen.append((info["time"], *pose, info["pose_error"][0], info["explored_fraction"], info["path_length"]))

    with EpisodeRecorder(env, explorer) as recorder:
        episode = run_episode(env, explorer, seed, watch)
    return recorder.recording(), episode, np.array(seen)


def test_a_recording_holds_what_happened_and_changes_nothing():
    env, calls = make_env(), []
    env.unwrapped.on_period = calls.append  # of another recorder
    recording, episode, seen = record(env, NearestExplorer())
    assert len(calls) == 1 + round(episode.duration / env.unwrapped.control_period)
    assert env.unwrapped.on_period == calls.append
    belief, start = env.unwrapped.belief, env.unwrapped.map_pose
    plain = run_episode(make_env(), NearestExplorer(), 0)
    np.testing.assert_array_equal(plain.history.of("explored_fraction"), episode.history.of("explored_fraction"))
    assert recording.time[0] == 0.0
    assert recording.time[-1] == pytest.approx(episode.duration)
    assert np.diff(recording.time)[:-1] == pytest.approx(0.5)
    rows = np.searchsorted(seen[:, 0], recording.time - 1e-3)
    np.testing.assert_allclose(recording.true_poses, seen[rows, 1:4], atol=1e-5)
    np.testing.assert_allclose(recording.progress, seen[rows, 5], atol=1e-6)
    np.testing.assert_allclose(recording.path_length, seen[rows, 6], atol=1e-5)
    away = start.transform(recording.poses[:, :2].astype(float)) - recording.true_poses[:, :2]
    np.testing.assert_allclose(np.hypot(*away.T), seen[rows, 4], atol=1e-5)
    known = crop_to_known(belief.grid, margin=0)
    expected = np.where(known.data < 0, 0, np.where(known.data >= 50, 2, 1))
    kinds = np.zeros(expected.shape, dtype=np.uint8)
    np.bitwise_xor.at(kinds.reshape(-1), recording.map_cells, recording.map_changes)
    np.testing.assert_array_equal(kinds, expected)
    assert recording.about["map"]["origin"] == pytest.approx(list(known.origin))
    assert recording.plan_ends[-1] > 0


@pytest.mark.parametrize("make", [GainOverCostExplorer, lambda: ScoreExplorer(FrontierScore()), NearestExplorer, None])
def test_decisions_are_recorded_with_the_scores_by_which_they_were_made(make):
    env = make_env() if make else make_env("lidarnaut/ExploreFrontiers-v0")
    explorer = make() if make else policies_for(env)["nearest"]()
    recording, episode, _ = record(env, explorer)
    assert len(recording.decision_times) >= (3 if make else 2)
    assert recording.time[-1] == pytest.approx(episode.duration)
    # A drive does not end with a return to an abandoned goal, even with the best score.
    assert (recording.decision_chosen >= 0).all()
    assert len(recording.markers) == 0
    if make:
        assert recording.decision_times[0] == 0.0
        first = recording.candidates[: recording.candidate_ends[0]]
        assert len(first) > 1
        assert first[recording.decision_chosen[0], 5] == first[:, 5].max()
        candidates = explorer.navigator.candidates
        last = recording.candidates[-len(candidates) :]
        np.testing.assert_allclose(last[:, :2], candidates["frontier"], atol=1e-5)
        np.testing.assert_allclose(last[:, 2], candidates["cost"], rtol=1e-6)
    if make is GainOverCostExplorer:
        np.testing.assert_allclose(last[:, 5], explorer.scores, rtol=1e-5)


def test_trees_and_points_are_recorded_once_with_the_samples_that_show_them():
    env, explorer = make_env(time_limit=8.0), RrtExplorer()
    shown = []

    def watch(info):
        if abs(info["time"] / 0.5 - round(info["time"] / 0.5)) < 1e-6:
            shown.append(marker_rows(env.unwrapped.overlay.markers() or Markers()))

    with EpisodeRecorder(env, explorer) as recorder:
        run_episode(env, explorer, 0, watch)
    recording = recorder.recording()
    assert len(shown) == len(recording.time) == 17
    replayed = set()
    for sample, rows in enumerate(shown):
        replayed ^= set(map(tuple, recording.markers[recording.markers[:, 0] == sample, 1:].tolist()))
        assert replayed == set(map(tuple, rows.tolist()))
    cluster, chosen, _, global_tree, local_tree = range(5)
    counts = {kind: (recording.markers[:, 1] == kind).sum() for kind in range(5)}
    assert len(recording.markers) == sum(counts.values())
    assert min(counts.values()) > 0
    # The global tree only grows; local trees begin anew.
    assert counts[global_tree] == (shown[-1][:, 0] == global_tree).sum() > 50
    assert counts[local_tree] > (shown[-1][:, 0] == local_tree).sum()
    np.testing.assert_allclose(shown[-1][shown[-1][:, 0] == cluster, 1:3], explorer.markers.clusters, atol=6e-4)
    np.testing.assert_allclose(shown[-1][shown[-1][:, 0] == chosen, 1:3], explorer.markers.chosen, atol=6e-4)
    assert len(recording.decision_times) == 0
    assert "<title>" in build_page([recording])


def test_predicted_floor_and_tours_are_recorded():
    tour = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    rows = marker_rows(Markers(predicted=np.array([[0.5, -1.0, 0.87]]), side=0.2, tour=tour))
    expected = [[5, 0.5, -1.0, 0.9, 0.2], [6, 0.0, 0.0, 1.0, 0.0], [6, 1.0, 0.0, 1.0, 2.0]]
    np.testing.assert_allclose(rows, expected, rtol=1e-6)
    env, explorer = make_env(time_limit=6.0), ForesightExplorer(Completion(CompletionNetwork()))
    explorer.rule.predict = lambda grid: Prediction(np.full((200, 200), 0.8, np.float32), 0.0, (-20.0, -20.0), 0.2)
    recording, *_ = record(env, explorer)
    assert set(recording.markers[:, 1]) == {5, 6}  # its candidates are those of the decisions
    assert len(recording.decision_times) > 2
    markers = explorer.markers
    assert (markers.predicted[:, 2] == np.float32(0.8)).all()
    assert len(markers.tour) > 1
    # A tour begins at the chosen frontier, at most a few cells away.
    assert np.hypot(*(markers.tour[0] - markers.chosen[0])) < 1.0


@pytest.mark.parametrize(
    ("id", "arguments"),
    [
        ("ExploreTeam", {"world": "turtlebot3_world"}),
        ("Navigate", {}),
        ("Track", {"world": "turtlebot3_world", "robot": "turtlebot3_burger", "map_resolution": 0.05, "path": BEND}),
    ],
)
def test_every_task_is_recorded_with_its_goal_route_and_teammates(id, arguments, tmp_path):
    env = gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic", time_limit=3.0, **arguments)
    env.reset(seed=0)
    policy = next(iter(policies_for(env).values()))()
    with EpisodeRecorder(env, policy) as recorder:
        episode = run_episode(env, policy, 0)
    (tmp_path / "episode.npz").write_bytes(recorder.recording().to_bytes())
    recording, task = Recording.load(tmp_path / "episode.npz"), env.unwrapped.task
    assert recording.progress[-1] == pytest.approx(episode.history.final[task.progress])
    assert recording.time[-1] == pytest.approx(episode.duration)
    goal = task.goal[:2] if id == "Navigate" else (np.nan, np.nan)
    np.testing.assert_allclose(recording.goals, np.tile(goal, (len(recording.time), 1)), atol=1e-5)
    assert len(recording.route) == (len(task.route.points) if id == "Track" else 0)
    assert recording.about["bodies"] == ["robot"] * (id == "ExploreTeam")
    assert len(recording.people_radii) == len(recording.about["bodies"])
    assert recording.plan_ends[-1] > 0 or id == "Track"
    assert "<title>" in build_page([recording])


def test_people_are_recorded_with_their_velocity_and_tracks_in_the_map_frame():
    env = gymnasium.make("lidarnaut/Explore-v0", world="turtlebot3_stage_4", physics="kinematic", slam="truth")
    with EpisodeRecorder(env) as recorder:
        env.reset(seed=0)
        env.unwrapped.overlay.tracks = np.array([[1.0, 2.0, 0.5, 0.0, 0.3]])
        for _ in range(5):
            env.step(np.zeros(2, dtype=np.float32))
    recording, people = recorder.recording(), env.unwrapped.simulator.people
    np.testing.assert_allclose(recording.people[-1].reshape(-1, 4), people[:, :4], rtol=1e-5)
    assert np.hypot(*people[:, 3:].T).min() > 0.05
    assert recording.about["bodies"] == ["fixed_route"] * len(people)
    np.testing.assert_allclose(recording.tracks, [[1.0, 2.0, 0.5, 0.0, 0.3]], rtol=1e-6)
    assert recording.track_ends.tolist() == [0, 1]


def test_who_ignores_the_robot_is_recorded():
    assert [BODY_KINDS[kind] for kind in (ATTENTIVE, BLIND, STANDING, FIXED_ROUTE)] == list(BODY_KINDS)
    arguments = {"people": "6?attentive=0.5", "physics": "kinematic", "time_limit": 1.0}
    env = gymnasium.make("lidarnaut/ReachCrowd-v0", **arguments)
    with EpisodeRecorder(env) as recorder:
        env.reset(seed=0)
    kinds = env.unwrapped.simulator.crowd.rows[:, KIND]
    bodies = recorder.recording().about["bodies"]
    assert [name == "blind" for name in bodies] == (kinds == BLIND).tolist()
    assert set(bodies) == {"attentive", "blind"}


def test_a_map_that_grows_and_is_redrawn_is_replayed():
    history = MapHistory(OccupancyGrid(np.full((2, 2), -1, np.int8), 0.5, (0.0, 0.0)))
    history.append(OccupancyGrid(np.array([[-1, 0], [-1, 100]], np.int8), 0.5, (0.0, 0.0)))
    history.append(OccupancyGrid(np.array([[30, -1, -1], [-1, -1, 0], [-1, 60, 100]], np.int8), 0.5, (-0.5, -0.5)))
    history.append(OccupancyGrid(np.array([[0, 100]], np.int8), 0.5, (0.5, 0.5)))  # the others are unknown again
    shape, origin, cells, changes, ends = history.arrays()
    maps, kinds = [], np.zeros(np.prod(shape), dtype=np.uint8)
    for cells_now, changes_now in zip(np.split(cells, ends[:-1]), np.split(changes, ends[:-1])):
        kinds[cells_now] ^= changes_now
        maps.append(kinds.reshape(shape).tolist())
    assert (shape, origin) == ([3, 4], [-0.5, -0.5])
    assert maps[0] == [[0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 2, 0]]
    assert maps[1] == [[1, 0, 0, 0], [0, 0, 1, 0], [0, 2, 2, 0]]
    assert maps[2] == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 2]]


def test_corners_keep_within_the_tolerance():
    turn = np.linspace(0.0, 3.0, 200)
    path = np.column_stack([turn, np.sin(3.0 * turn)])
    kept = corners(path, PLAN_TOLERANCE)
    assert len(kept) < 40
    away = np.abs(path[:, 1] - np.interp(path[:, 0], *kept.T))
    assert away.max() < 3.2 * PLAN_TOLERANCE  # across a slope of 3, vertical distances are longer
    np.testing.assert_array_equal(corners(np.array([(0, 0), (1, 0), (2, 0), (2, 1.0)]), 0.1), [(0, 0), (2, 0), (2, 1)])
    np.testing.assert_array_equal(corners(path[:2], 0.1), path[:2])


def test_a_recording_is_read_as_it_was_written_and_has_the_same_bytes_each_time(tmp_path):
    recording = synthetic(20.0)
    path = tmp_path / "episode.npz"
    path.write_bytes(recording.to_bytes())
    loaded = Recording.load(path)
    assert loaded.about == recording.about | {"format": 3}
    for name, array in recording.arrays.items():
        np.testing.assert_array_equal(getattr(loaded, name), array)
    assert loaded.to_bytes() == recording.to_bytes() == synthetic(20.0).to_bytes()


def changed(name, change):
    """Bytes of a recording with one array changed, or omitted if `change` returns None."""
    with np.load(io.BytesIO(synthetic(5.0).to_bytes())) as archive:
        arrays = {**archive, name: change(archive[name])}
    content = io.BytesIO()
    np.savez(content, **{key: array for key, array in arrays.items() if array is not None})
    return content.getvalue()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"<html>", "allow_pickle"),
        (changed("scans", lambda scans: None), "lacks scans"),
        (changed("time", lambda time: time[:-1]), "not (10"),
        (changed("plan_ends", lambda ends: ends + 1), "plan_ends do not match plans"),
        (changed("markers", lambda markers: np.zeros((1, 5), np.float32)), "markers has shape (1, 5)"),
        (changed("markers", lambda markers: np.eye(2, 6, dtype=np.float32)), "markers are not sorted by sample"),
        (changed("markers", lambda markers: np.full((1, 6), np.nan, np.float32)), "markers are not sorted by sample"),
        (changed("poses", lambda poses: poses.astype(float)), "poses is float64"),
        (changed("map_cells", lambda cells: cells + 10**6), "outside of the map"),
        (changed("about", lambda _: np.frombuffer(b'{"format": 7}', np.uint8)), "format 7"),
        (changed("about", lambda _: np.frombuffer(b'{"format": 3}', np.uint8)), "about lacks explorer, figures, floor"),
    ],
)
def test_what_is_no_recording_is_named(tmp_path, content, says):
    (tmp_path / "other.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.npz is not a recorded episode") as error:
        Recording.load(tmp_path / "other.npz")
    assert says in str(error.value)
    assert "\n" not in str(error.value)
