import re
import webbrowser

import pytest

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.player import build_page
from lidarnaut.envs.player.__main__ import main
from tests.player.episodes import synthetic


def test_an_hour_in_a_large_hall_stays_below_five_megabytes_and_loads_nothing():
    page = build_page([synthetic(3600.0, (50.0, 30.0), num_candidates=20, flicker=40)])
    assert len(page) < 5e6
    assert re.findall(r"https?:|src=|<link|@import", re.sub(r'id="data">[^<]*', "", page)) == []


def test_names_are_escaped_and_the_same_episodes_make_the_same_page():
    page = build_page([synthetic(5.0, explorer="<b>&"), synthetic(5.0)])
    assert "<title>&lt;b&gt;&amp; and made_up in hall</title>" in page
    assert page == build_page([synthetic(5.0, explorer="<b>&"), synthetic(5.0)])
    assert r"<title>\ud800\x1b[2J in hall</title>" in build_page([synthetic(5.0, explorer="\ud800\x1b[2J")])


def test_the_command_writes_the_page_and_opens_it(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    (tmp_path / "a.npz").write_bytes(synthetic(5.0).to_bytes())
    out = tmp_path / "new" / "page.html"
    run_command(main, [str(tmp_path / "a.npz"), "--out", str(out)])
    assert out.read_text().startswith("<!doctype html>")
    assert opened == [out.as_uri()]
    run_command(main, [str(tmp_path / "a.npz"), str(tmp_path / "a.npz"), "--out", str(out), "--no-open"])
    assert len(opened) == 1
    assert str(out) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["missing.npz"], "missing.npz"),
        (["notes.txt"], "notes.txt is not a recorded episode"),
        (["a.npz", "a.npz", "a.npz"], "shows 1 to 2 episodes, got 3"),
        ([], "shows 1 to 2 episodes, got 0"),
    ],
)
def test_wrong_input_is_named_in_one_line(tmp_path, capsys, names, says):
    (tmp_path / "a.npz").write_bytes(synthetic(5.0).to_bytes())
    (tmp_path / "notes.txt").write_text("no episode")
    out = tmp_path / "page.html"
    with pytest.raises(SystemExit, match="2"):
        run_command(main, [*(str(tmp_path / name) for name in names), "--out", str(out), "--no-open"])
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not out.exists()
