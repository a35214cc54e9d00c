"""The page in a real browser: Debian's chromium, without a window."""

from pathlib import Path

import pytest

from lidarnaut.envs.player import build_page
from tests.browser import needs_browser, visit
from tests.player.episodes import synthetic

HARNESS = Path(__file__).with_name("harness.html")
pytestmark = needs_browser


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Return what the harness reports of two episodes, of a minute and of half a minute, by the width of the page."""
    folder = tmp_path_factory.mktemp("pair")
    page = build_page([synthetic(60.0), synthetic(30.0, explorer="other", seed=1)])
    (folder / "page.html").write_text(page)
    return {width: visit(folder, HARNESS, f"page=page.html&width={width}") for width in (1280, 390)}


@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_draws_and_fits(pair, width):
    report = pair[width]
    assert report["errors"] == []
    assert report["samples"] == "121 61"
    assert report["overflow"] <= 0  # nothing to scroll sideways
    # The panels lie side by side, or one below the other where the page is narrow.
    truth, estimate = report["boxes"][:2]
    assert (estimate["left"] > truth["right"]) == (width > 600)
    assert (estimate["top"] > truth["bottom"]) == (width <= 600)
    for name in ("true", "wall", "lidar", "person"):
        assert report["colors"][0].get(name, 0) > 20, name
    for name in ("estimated", "plan", "frontier", "free", "unknown"):
        assert report["colors"][1].get(name, 0) > 20, name


def test_time_is_set_by_line_keys_and_plot_and_runs_by_itself(pair):
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


def test_both_episodes_run_in_step_and_the_shorter_one_stays_at_its_end(pair):
    at_20, at_end = pair[1280]["explored"]["opened"], pair[1280]["explored"]["end"]
    assert at_20 == ["43.3 %", "71.7 %"]
    assert at_end == ["100.0 %", "100.0 %"]
    assert "Ended after 0:30: time limit" in pair[1280]["decisions"]["end"][1]


def test_maps_run_backwards_to_what_they_were_and_candidates_are_described_where_one_points(pair):
    assert pair[1280]["isMapRestored"]
    assert pair[1280]["isMapChanged"]
    assert all(word in pair[1280]["tip"] for word in ("score", "path"))


def test_an_hour_opens_within_two_seconds_of_processor_time(tmp_path):
    page = build_page([synthetic(3600.0, (50.0, 30.0), num_candidates=20, flicker=40)])
    (tmp_path / "page.html").write_text(page)
    (tmp_path / "brief.html").write_text(build_page([synthetic(1.0)]))
    brief, hour = (visit(tmp_path, HARNESS, f"page={name}.html&width=1280&brief=1") for name in ("brief", "page"))
    assert hour["errors"] == []
    assert hour["samples"] == "7201"
    # Processor time of all threads, beyond the browser's own start: the clock says little where cores are shared.
    assert hour["processor_time"] - brief["processor_time"] <= 2.0
