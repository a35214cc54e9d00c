import io
import sys

from envs import progress
from envs.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def run(file, monkeypatch, **options):
    """Let a bar of 40 items run, a second each, with a bar of its own for the tenth; return what is written."""
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    monkeypatch.setattr(sys, "stderr", file)
    for k in Progress(range(40), desc="items", mininterval=0.0, **options):
        now += 1.0
        if k == 10:
            list(Progress(range(3), desc="parts", leave=False))
            Progress.write("a note", file=file)
    return file.getvalue()


def test_where_there_is_no_terminal_whole_lines_are_written_now_and_then(monkeypatch):
    written = run(io.StringIO(), monkeypatch)
    assert not {"\r", "\x1b"} & set(written)
    assert written.endswith("\n")
    shares = [line.split("|")[0] for line in written.splitlines()]
    items = [f"items: {percent:3d}%" for percent in (0, 25, 50, 75, 100)]
    assert shares == [*items[:2], "parts:   0%", "a note", *items[2:]]


def test_on_a_terminal_the_bar_stays_on_its_line(monkeypatch):
    written = run(Terminal(), monkeypatch)
    assert written.count("\r") > 40
    assert "40/40" in written.split("\r")[-1]


def test_bars_that_are_short_or_switched_off_write_nothing(monkeypatch):
    for file in (io.StringIO(), Terminal()):
        monkeypatch.setattr(sys, "stderr", file)
        list(Progress(range(5), delay=60.0))
        list(Progress(range(5), disable=True))
        assert file.getvalue() == ""
