import math

import numpy as np
import pytest
from PIL import Image

from lidarnaut.benchmarks.drives import localization, teams
from lidarnaut.benchmarks.drives.__main__ import main, table
from lidarnaut.benchmarks.drives.localization import compare_amcl, load_known_world, record_from_anywhere
from lidarnaut.benchmarks.drives.maps import wrong_cells
from lidarnaut.benchmarks.drives.recording import Drive, first_time, right_since, run_each
from lidarnaut.benchmarks.drives.slams import compare_kidnapped, compare_slams
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.rendering import style
from tests.data import INTEL, needs_intel


def test_a_drive_is_what_the_robot_saw_and_is_repeatable():
    setup = load_known_world("turtlebot3_world")
    one, same = (record_from_anywhere(setup, np.random.SeedSequence(4), 2.0) for _ in range(2))
    assert one.ranges.tobytes() == same.ranges.tobytes()
    assert one.truth.shape == one.motions.shape == (21, 3)
    np.testing.assert_array_equal(one.motions[0], 0.0)
    length = np.hypot(*np.diff(one.truth[:, :2], axis=0).T).sum()
    assert np.hypot(*one.motions[:, :2].T).sum() == pytest.approx(length, rel=0.1)


def test_kidnapping_joins_two_drives():
    first, second = (Drive(np.full((n, 2), k), *np.full((2, n, 3), k), np.full(n, k)) for n, k in ((5, 0), (4, 1)))
    joined = first.then(second, 3)
    for values in (joined.ranges[:, 0], joined.motions[:, 0], joined.truth[:, 0], joined.bumper):
        assert values.tolist() == [0, 0, 0, 1, 1, 1, 1]


def test_times_that_were_never_reached_are_infinite_or_none():
    never = np.zeros(600, dtype=bool)
    late = never.copy()
    late[100:] = True
    assert right_since(never, 5.0) == first_time(never) == math.inf
    assert right_since(late, 5.0) == first_time(late) == pytest.approx(10.0)
    assert right_since(late, 51.0) == math.inf
    assert localization.time_quantile([1.0, 3.0, math.inf], 0.5) == 3.0
    assert localization.time_quantile([1.0, 2.0, 3.0, math.inf], 0.5) == 2.5
    assert localization.time_quantile([1.0, math.inf, math.inf], 0.5) is None


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_the_order_of_the_tasks_and_an_error_ends_the_others(jobs):
    assert run_each(math.hypot, [(3.0, 4.0), (6.0, 8.0)], jobs, "") == [5.0, 10.0]
    with pytest.raises(ValueError, match="math domain"):
        run_each(math.sqrt, [(-1.0,), (1.0,)], jobs, "")


def test_the_command_prints_a_table(capsys):
    main(lambda: [{"slam": "hector", "after_s": None, "ms": 0.12345}, {"slam": "graph"}])
    assert {"slam", "hector", "never", "0.1235", "graph"} <= set(capsys.readouterr().out.split())
    wide = table([{f"measure {k}": k for k in range(12)}])
    assert (len(wide.columns), wide.row_count) == (2, 11)


def test_slams_on_a_drive_are_measured_and_drawn(tmp_path):
    path = tmp_path / "maps.png"
    drives = ("turtlebot3_world:turtlebot3_burger",)
    rows = compare_slams(("odometry", "hector"), drives, seeds=2, minutes=0.2, picture=path)
    assert [row["slam"] for row in rows] == ["odometry", "hector"]
    assert all(row["translation_m"] < 0.05 and row["map_iou"] > 0.2 for row in rows)
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape[1] == 1050
    for colour in (style.FREE, style.UNKNOWN):
        assert (np.abs(pixels - colour).max(axis=2) < 12).sum() > 2000
    assert (np.abs(pixels - style.TRUE).max(axis=2) < 60).sum() > 20


def test_kidnapped_robots_are_counted_by_world_and_together():
    rows = compare_kidnapped(("hector",), ("turtlebot3_world",), seeds=1, minutes=0.1, seconds=1.0)
    assert [(row["world"], row["robots"]) for row in rows] == [("turtlebot3_world", 1), ("all", 1)]
    assert rows[0]["relocalized_after_s"] is None


def test_the_log_is_passed_or_in_the_folder_of_data(monkeypatch, tmp_path):
    monkeypatch.delenv("LIDARNAUT_DATA", raising=False)
    with pytest.raises(ValueError, match="pass --log FILE, or set LIDARNAUT_DATA"):
        localization.compare_on_log()
    monkeypatch.setenv("LIDARNAUT_DATA", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=str(tmp_path / "intel" / "scans_2725.npz")):
        localization.compare_on_log()


@needs_intel
def test_amcl_on_a_log(monkeypatch):
    monkeypatch.setattr(localization, "FILTERS", {"default": localization.NO_RELOCALIZATION})
    monkeypatch.setattr(localization, "LOG_SEEDS", range(100, 101))
    (row,) = localization.compare_on_log(INTEL / "scans_2725.npz")
    assert row["position_rmse_m"] < 0.07
    assert row["lost_share"] == 0.0


def test_walls_out_of_place_are_found():
    walls = OccupancyGrid(np.zeros((10, 10), dtype=np.int8), 1.0, (0.0, 0.0))
    walls.data[2, 3:6] = 100
    data = np.full((6, 30), -1, dtype=np.int8)
    data[4, 6], data[4, 14], data[4, 20], data[5, 14] = 100, 100, 100, 0
    grid = OccupancyGrid(data, 0.5, (0.0, -2.0))  # cells twice as wide: (3.25, 0.25), (7.25, 0.25), (10.25, 0.25) m
    assert np.argwhere(wrong_cells(grid, Pose2D(0.0, 2.0, 0.0), walls)).tolist() == [[4, 14], [4, 20]]


def test_a_robot_is_tracked_localized_and_kidnapped():
    (row,) = compare_amcl(runs=1, jobs=1, worlds=("turtlebot3_world",))
    assert row["tracking_rmse_m"] < 0.03
    assert row["tracking_rmse_deg"] < 0.7
    assert 0 <= row["global_success"] <= 1
    assert 0 <= row["confident_and_wrong"] < 0.5


@pytest.mark.parametrize(
    ("times", "shown", "ratio"),
    [
        # 300 / 100 and 100 / 80, not the ratio of the means.
        (
            [100.0, 300.0, 80.0, 100.0],
            ["200 [100 to 300; only 2 starts]", "90 [80 to 100; only 2 starts]"],
            "2.12 [1.25 to 3.00; only 2 starts]",
        ),
        ([math.inf, math.inf, 100.0, 100.0], ["never [> 600 s]", "100 [only 2 starts]"], "> 6.00 [never]"),
        (
            [100.0, 300.0, math.inf, math.inf],
            ["200 [100 to 300; only 2 starts]", "never [> 600 s]"],
            "0.33 [0.17 to 0.50; only 2 starts]",
        ),
    ],
)
def test_speed_ups_are_taken_pair_by_pair_and_marks_that_were_never_reached_are_shown(times, shown, ratio):
    row = {"world": "rooms", "robot": "tugbot", "physics": "kinematic", "slam": "tinyslam", "time_limit": 600.0}
    row |= {"path_length": 10.0, "collisions": 0.0}
    starts = [("rrt_team 1", 1), ("rrt_team 1", 0), ("rrt_team 2", 1), ("rrt_team 2", 0)]
    rows = [row | {"policy": name, "seed": seed, "time_to_95": t} for (name, seed), t in zip(starts, times)]
    lines = teams.summarise(rows, (1, 2), ("rrt_team",))
    assert [line["time to 95 %, s"] for line in lines] == shown
    assert lines[1]["T(1) / T(n)"] == ratio
    assert [line["reached"] for line in lines] == [f"{sum(map(math.isfinite, times[k : k + 2]))} of 2" for k in (0, 2)]


def test_teams_of_all_sizes_are_evaluated_from_the_same_starts_and_only_once(tmp_path, monkeypatch):
    arguments = {"worlds": ("pimouse_arena",), "robots": (1, 2), "episodes": 1, "jobs": 1}
    first = teams.compare_teams(**arguments, out=tmp_path)
    monkeypatch.setattr("lidarnaut.benchmarks.arena.workers.run_episode", lambda *_: pytest.fail("was run again"))
    assert teams.compare_teams(**arguments, out=tmp_path) == first
    assert [line["reached"] for line in first] == ["1 of 1"] * 2
