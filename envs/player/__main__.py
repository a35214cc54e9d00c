"""Show one or two recorded episodes in the browser: `python -m lidarnaut.envs.player EPISODE [EPISODE]`."""

import sys
import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated

import tyro

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import write_file

from .page import build_page
from .recording import Recording


def main(
    episodes: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path | None = None, open: bool = True
) -> None:
    """Write a web page that replays recorded episodes, and open the page in the browser.

    Args:
        episodes: one or two recordings (.npz) from `evaluate.py --record`.
        out: path of the page; default: a temporary file.
        open: whether to open the page in the browser.
    """
    page = build_page([Recording.load(path) for path in episodes])
    out = out or Path(tempfile.mkdtemp(prefix="lidarnaut_")) / "episode.html"
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, page)
    sys.stdout.write(f"{out}: {len(page) / 1e6:.1f} MB\n")
    if open:
        webbrowser.open(out.resolve().as_uri())


if __name__ == "__main__":
    run_command(main)
