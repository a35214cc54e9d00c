"""Hold files of the package against public tools: `python -m tests.outside [--only WORD] [--write PAGE]`.

Prints tables of files and tools, and ends with status 1 if a result is not as expected: docs/reference/formats.md.
"""

import re
import sys
import tempfile
import time
from pathlib import Path

from lidarnaut.envs.command_line import run_command

from .checks import read_by_others, trained_by_others
from .files import Files
from .inputs import written_by_others

TABLES = {
    "| file | tool | result |": read_by_others,
    "| library | version | result |": trained_by_others,
    "| reader | written by | result |": written_by_others,
}
"""Rows by the head of the table in the page."""


def main(*, only: str = "", write: Path | None = None) -> None:
    """Print the tables. `only`: word of a file or tool, `learning` or `inputs`; `write`: page whose tables change."""
    started, wrong, page = time.monotonic(), 0, write.read_text() if write else ""
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder))
        for head, cells in TABLES.items():
            rows = [head, "|---|---|---|"]
            for cell in cells(files, only):
                text, is_right = cell.result(files)
                rows.append(f"| {cell.file} | {cell.tool} | {text.replace(folder, '').replace('|', '/')} |")
                print(("" if is_right else "WRONG ") + rows[-1], flush=True)
                wrong += not is_right
            table = "\n".join(rows) + "\n"
            page = re.sub(re.escape(head) + r"\n(\|.*\n)*", lambda _, table=table: table, page)
    print(f"{wrong} results are wrong; {time.monotonic() - started:.0f} s")
    if write:
        write.write_text(page)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    run_command(main)
