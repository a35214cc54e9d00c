import re

import pytest

from lidarnaut.benchmarks.arena.evaluation_folder import read_table
from lidarnaut.benchmarks.arena.trace import Trace
from lidarnaut.benchmarks.arena.workers import describe
from lidarnaut.envs.player import Recording
from lidarnaut.evaluate_command import main
from tests.benchmarks.explorations import COLUMNS, MEASURES

POLICIES = ("--policies", "random", "nearest", "--worlds", "turtlebot3_world")
OPTIONS = (*POLICIES, "--episodes", "2", "--physics", "kinematic", "--time-limit", "4")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    assert main([*OPTIONS, "--record", "--out", str(folder)]) == 0
    return folder


def test_recordings_hold_the_episodes_and_change_nothing(folder, tmp_path):
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
