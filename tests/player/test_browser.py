from functools import cache
from pathlib import Path

import pytest

from lidarnaut.envs.player import build_page
from tests.browser import needs_browser, visit
from tests.player.episodes import synthetic

HARNESS = Path(__file__).with_name("harness.html")
pytestmark = needs_browser


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Return the harness's reports on episodes of 60 s and 30 s, by page width."""
    folder = tmp_path_factory.mktemp("pair")
    page = build_page([synthetic(60.0), synthetic(30.0, explorer="other", seed=1)])
    (folder / "page.html").write_text(page)
    return {width: visit(folder, HARNESS, f"page=page.html&width={width}") for width in (1280, 390)}


@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_draws_and_fits(pair, width):
    report = pair[width]
    assert report["errors"] == []
    assert report["samples"] == "121 61"
    assert report["overflow"] <= 0
    # The panels are side by side, or one below the other on a narrow page.
    truth, estimate = report["boxes"][:2]
    assert (estimate["left"] > truth["right"]) == (width > 600)
    assert (estimate["top"] > truth["bottom"]) == (width <= 600)
    for name in ("true", "wall", "lidar", "person"):
        assert report["colors"][0].get(name, 0) > 20, name
    for name in ("estimated", "plan", "frontier", "free", "unknown"):
        assert report["colors"][1].get(name, 0) > 20, name


def test_time_is_set_by_line_keys_and_plot_and_runs_by_itself_for_both_episodes(pair):
    report = pair[1280]
    assert report["clocks"] == {
        "opened": "0:20 / 1:00",  # the harness asks for #t=20
        "right": "0:25 / 1:00",
        "shift left": "0:00 / 1:00",
        "end": "1:00 / 1:00",
        "line": "0:12 / 1:00",
        "plot": "0:30 / 1:00",
    }
    assert report["played"] > 1.0
    assert report["explored"]["opened"] == ["43.3 %", "71.7 %"]
    assert report["explored"]["end"] == ["100.0 %", "100.0 %"]
    assert "score 8.00; number 1 of 5 by score" in report["decisions"]["opened"][0]
    assert "Ended after 0:30: time limit" in report["decisions"]["end"][1]
    assert report["isMapRestored"]
    assert report["isMapChanged"]
    assert all(word in report["tip"] for word in ("score", "path"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of pages: of an episode with a map, of one without, and of two of each."""
    folder = tmp_path_factory.mktemp("pages")
    mapped, bare = synthetic(60.0), synthetic(60.0, is_bare=True)
    for name, episodes in {"mapped": [mapped], "bare": [bare], "both": [mapped] * 2, "crowd": [bare] * 2}.items():
        (folder / f"{name}.html").write_text(build_page(episodes))
    return folder


WINDOW, FRAME = (1280, 800), (784, 736)
"""Width and height of a window, and of the frame on the site."""


@pytest.fixture(scope="module")
def visited(folder):
    return cache(
        lambda name, size: visit(folder, HARNESS, f"page={name}.html&width={size[0]}&height={size[1]}&brief=1")
    )


@pytest.mark.parametrize(
    ("name", "size"), [("mapped", WINDOW), ("mapped", FRAME), ("bare", WINDOW), ("both", FRAME), ("crowd", FRAME)]
)
def test_a_page_fits_its_window_and_nothing_covers_the_plots(visited, name, size):
    answer = visited(name, size)
    assert answer["errors"] == []
    layout = answer["layout"]
    assert layout["scrolled"] <= 0
    assert layout["play"]["bottom"] <= layout["controls"]["bottom"] <= size[1]
    assert all(plot["bottom"] <= layout["controls"]["top"] for plot in layout["plots"])
    assert len(layout["panels"]) == {"mapped": 2, "bare": 1, "both": 4, "crowd": 2}[name]
    assert all(min(panel["width"], panel["height"]) > 120 for panel in layout["panels"])


def test_only_what_a_recording_has_is_shown(visited):
    mapped, bare = (visited(name, WINDOW)["layout"] for name in ("mapped", "bare"))
    assert mapped["legend"] == [
        *("true path", "scan", "person or other robot", "estimated path", "frontier", "candidate"),
        *("chosen candidate", "plan", "tracked person", "contact"),
    ]
    assert mapped["labels"][1:] == ["Candidates", "Scan"]
    assert len(mapped["plots"]) == 2
    assert bare["legend"] == ["true path", "scan", "person who ignores the robot", "other robot", "contact"]
    assert bare["labels"][1:] == ["Scan"]
    assert len(bare["plots"]) == 1
    assert not any("candidate" in text.lower() for text in bare["texts"])


def test_trees_and_goals_without_scores_are_drawn(tmp_path):
    (tmp_path / "page.html").write_text(build_page([synthetic(60.0, num_candidates=0, has_trees=True)]))
    report = visit(tmp_path, HARNESS, "page=page.html&width=1280")
    assert report["errors"] == []
    assert report["layout"]["legend"][5:9] == [
        *("global tree", "local tree, found points", "candidate", "chosen candidate")
    ]
    assert report["layout"]["labels"][1:] == ["Candidates", "Scan"]
    assert not any("tap it" in text for text in report["layout"]["texts"])
    truth, belief = report["colors"][:2]
    for name in ("global", "local"):
        assert belief.get(name, 0) > 50, name
        assert truth.get(name, 0) == 0, name
    assert report["isMapRestored"]  # after a visit to the end, when one tree has vanished


def test_an_hour_opens_within_two_seconds_of_processor_time(tmp_path):
    page = build_page([synthetic(3600.0, (50.0, 30.0), num_candidates=20, flicker=40)])
    (tmp_path / "page.html").write_text(page)
    (tmp_path / "brief.html").write_text(build_page([synthetic(1.0)]))
    brief, hour = (visit(tmp_path, HARNESS, f"page={name}.html&width=1280&brief=1") for name in ("brief", "page"))
    assert hour["errors"] == []
    assert hour["samples"] == "7201"
    # Processor time of all threads minus the browser's start-up: wall time is unreliable on shared cores.
    assert hour["processor_time"] - brief["processor_time"] <= 2.0
