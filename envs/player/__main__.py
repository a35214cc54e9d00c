"""Show recorded episodes in the browser: `python -m envs.player EPISODE [EPISODE]`."""

import sys
import tempfile
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from envs.command_line import fail, read_options
from envs.files import write_file

from .page import MAX_EPISODES, build_page
from .recording import Recording


@dataclass(frozen=True)
class Options:
    """Show a recorded episode in the browser, or two in step."""

    episodes: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recordings (.npz) that `evaluate.py --record` left, one or two."""
    out: Path | None = None
    """The page; without it, a file in the temporary folder."""
    open: bool = True
    """Whether to open the page in the browser."""


def main(arguments: list[str] | None = None) -> int:
    """Read the command line, write the page and open it; return the exit status."""
    try:
        options = read_options(Options, arguments, description=__doc__)
        if not 1 <= len(options.episodes) <= MAX_EPISODES:
            raise ValueError(f"one or two episodes can be shown, got {len(options.episodes)}")
        page = build_page([Recording.load(path) for path in options.episodes])
        out = options.out or Path(tempfile.mkdtemp(prefix="lidarnaut_")) / "episode.html"
        out.parent.mkdir(parents=True, exist_ok=True)
        write_file(out, page)
    except (ValueError, OSError) as error:
        return fail(error)
    sys.stdout.write(f"{out}: {len(page) / 1e6:.1f} MB\n")
    if options.open:
        webbrowser.open(out.resolve().as_uri())
    return 0


if __name__ == "__main__":
    sys.exit(main())
