"""Hold files of the package against public tools: `python -m tests.outside [--only WORD] [--write PAGE]`.

Prints tables of files and tools, and ends with status 1 if a result is not as expected: docs/reference/formats.md.
"""

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path

from .checks import read_by_others, trained_by_others
from .files import Files
from .inputs import written_by_others

TABLES = {
    "| file | tool | result |": read_by_others,
    "| library | version | result |": trained_by_others,
    "| reader | written by | result |": written_by_others,
}
"""Rows by the head of the table in the page."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.outside", description=__doc__)
    words = "word of the file or tool, `learning` or `inputs`: a part of the tables"
    parser.add_argument("--only", default="", help=words)
    parser.add_argument("--write", type=Path, help="page whose tables are replaced")
    options, started, wrong = parser.parse_args(), time.monotonic(), 0
    page = options.write.read_text() if options.write else ""
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder))
        for head, cells in TABLES.items():
            rows = [head, "|---|---|---|"]
            for cell in cells(files, options.only):
                text, is_right = cell.result(files)
                rows.append(f"| {cell.file} | {cell.tool} | {text.replace(folder, '').replace('|', '/')} |")
                print(("" if is_right else "WRONG ") + rows[-1], flush=True)
                wrong += not is_right
            table = "\n".join(rows) + "\n"
            page = re.sub(re.escape(head) + r"\n(\|.*\n)*", lambda _, table=table: table, page)
    print(f"{wrong} results are wrong; {time.monotonic() - started:.0f} s")
    if options.write:
        options.write.write_text(page)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
