import re
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.benchmarks.arena.evaluation_folder import read_table
from lidarnaut.benchmarks.arena.plots import draw_growth
from lidarnaut.benchmarks.arena.trace import Trace
from lidarnaut.benchmarks.arena.workers import describe
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.player import Recording
from lidarnaut.evaluate_command import main
from tests.benchmarks.explorations import COLUMNS, MEASURES, deterministic, read_rows
from tests.slam.rooms import wall_distances

POLICIES = ("--policies", "random", "nearest", "--worlds", "turtlebot3_world")
OPTIONS = (*POLICIES, "--episodes", "2", "--physics", "kinematic", "--time-limit", "4")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    assert main([*OPTIONS, "--record", "--bags", str(folder / "bags"), "--out", str(folder)]) == 0
    return folder


def test_recordings_and_bags_hold_the_episodes_and_change_nothing(folder, tmp_path):
    assert main([*OPTIONS, "--out", str(tmp_path)]) == 0
    assert not (tmp_path / "recordings").exists()
    assert not (tmp_path / "players").exists()
    assert "<a " not in (tmp_path / "report.html").read_text()
    names = sorted(path.name for path in (folder / "episodes").iterdir())
    assert sorted(path.name for path in (folder / "recordings").iterdir()) == names
    for name in names:
        trace, recording = Trace.load(folder / "episodes" / name), Recording.load(folder / "recordings" / name)
        assert (folder / "episodes" / name).read_bytes() == (tmp_path / "episodes" / name).read_bytes()
        assert recording.progress[-1] == trace.curve.progress[-1]
        assert recording.about["map"]["shape"] == list(trace.grid.data.shape)
    rows = read_rows(folder)
    assert sorted(map(str, deterministic(rows))) == sorted(map(str, deterministic(read_rows(tmp_path))))
    bags = sorted((folder / "bags").iterdir())
    assert [f"{bag.stem}.npz" for bag in bags] == names
    for bag, row in zip(bags, sorted(rows, key=lambda row: (row["policy"], row["seed"])), strict=True):
        log = load_log(bag)
        assert log.times[-1] - log.times[0] == pytest.approx(float(row["duration"]))
        assert len(log.ranges) == 1 + round(10.0 * float(row["duration"]))


def test_traces_hold_the_maps_as_they_grew(folder):
    path, _ = sorted((folder / "episodes").glob("nearest*"))
    trace = Trace.load(path)
    known = trace.grid.data >= 0
    np.testing.assert_array_equal(known, np.isfinite(trace.known_since))
    assert known.any(axis=0)[[0, -1]].all()
    assert known.any(axis=1)[[0, -1]].all()
    assert len(trace.trail) == len(trace.curve.time) == 41
    assert 0.5 < np.mean(trace.known_since[known] == 0.0) < 1.0
    assert 3.0 < trace.known_since[known].max() <= 4.0
    # Seen from the start, occupied cells are along true walls.
    cells = np.argwhere(trace.grid.data >= 65)
    points = trace.start.transform(trace.grid.centers(cells[np.isfinite(trace.known_since[tuple(cells.T)])]))
    assert np.mean(wall_distances(points, trace.segments, trace.circles) < 0.15) > 0.95


def test_strips_show_the_goal_and_label_both_ends_of_the_colour_bar(folder):
    path, _ = sorted((folder / "episodes").glob("nearest*"))
    trace = Trace.load(path)
    assert np.isnan(trace.goal).all()
    slower = trace.curve._replace(time=0.9 * trace.curve.time)
    *maps, bar = draw_growth("nearest", replace(trace, curve=slower, goal=np.array([1.0, 2.0]))).axes
    assert [label.get_text() for label in bar.get_yticklabels()] == ["0", "4"]
    assert bar.get_ylim() == (0.0, pytest.approx(bar.get_yticks()[1]))
    for axes in maps:
        np.testing.assert_allclose(axes.lines[-1].get_xydata(), [trace.start.transform(np.array([1.0, 2.0]))])


def test_the_report_links_to_pages_of_typical_and_worst_episodes(folder):
    report = (folder / "report.html").read_text()
    links = re.findall(r'<a href="([^"]+)">turtlebot3_world, seed [01]</a>', report)
    assert len(links) == 4
    assert {folder / link for link in links} == set((folder / "players").iterdir())
    titles = {re.search("<title>(.*)</title>", (folder / link).read_text())[1] for link in links}
    assert titles == {"nearest in turtlebot3_world", "random and nearest in turtlebot3_world"}


def test_what_was_not_recorded_is_left_out(folder, tmp_path):
    for path in (folder / "recordings").glob("nearest*"):
        path.rename(tmp_path / path.name)
    try:
        assert main([*OPTIONS, "--report", "--out", str(folder)]) == 0
    finally:
        for path in tmp_path.glob("nearest*"):
            path.rename(folder / "recordings" / path.name)
    report = (folder / "report.html").read_text()
    links = re.findall(r'<a href="([^"]+)">', report)
    assert {"random" in link for link in links} == {True}
    assert "<title>random in turtlebot3_world</title>" in (folder / links[0]).read_text()


def test_figures_are_texts_with_units_and_without_times_of_the_machine(folder):
    row = next(read_table(folder / "episodes.csv", COLUMNS))
    figures = describe(row, MEASURES)["figures"]
    shown = {"time to 95 % [s]": "never", "explored [%]": f"{100 * row['explored_fraction']:.1f}"}
    shown |= {"collisions": f"{row['collisions']:.0f}", "ended by": "time limit"}
    assert shown.items() <= figures.items()
    assert not any("decision" in name for name in figures)
