"""Hold files of the package against public tools: `python -m tests.outside [--only WORD] [--write PAGE]`.

Prints a table of files and tools, and ends with status 1 if a cell is not as expected. See `docs/reference/formats.md`.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from .checks import CHECKS, Check
from .environments import PINS, RefusedError, SkippedError, run, version_of
from .files import Files
from .inputs import DOORS, Input

INTRODUCTION = """# Formats, checked by other tools

`make test-outside` writes this page. It installs public packages at the versions below, each group in an environment of
its own (`.venv-outside`), and runs them on files of this package. `equal` means: the same messages, poses, cells,
actions or links, within the precision of the format. Tools that cannot be installed on a machine are skipped.
Shell scripts in the folder `findings` show surprises of these tools without this package.
"""
CLIENTS = """## Libraries for learning

One short run each, with an environment of this package; [how to use them](../guides/other_libraries.md). d3rlpy 2.8.1
requires Gymnasium 1.0.0, and imitation 1.0.1 requires Gymnasium 0.29, so that pip installs neither with this package.
"""
INPUTS = """## Files of other tools

Files that other tools write from valid data, given to the readers of this package. `read` means: the same content.
Pose graphs, trajectories and URDF files have no reader here, and are refused in one line.
"""


def outcome(compare: Callable[[], str], right: str) -> str:
    """Return the text of a cell: `right`, `differs: ...`, `refused: ...` or `skipped: ...`."""
    try:
        why = compare()
    except SkippedError as error:
        return f"skipped: {error}"
    except RefusedError as error:
        return f"refused: {error}"
    return f"differs: {why}" if why else right


def check_files(files: Files, only: str) -> Iterator[tuple[list[str], bool]]:
    for check in CHECKS:
        if only in f"{check.file} {check.package}":
            cell = outcome(lambda check=check: check.compare(files), "equal")
            yield row_of(check, cell), cell.startswith("skipped") or (cell == "equal") is not bool(check.known)


def row_of(check: Check, cell: str) -> list[str]:
    known = cell.startswith(("differs", "refused")) and check.known
    cell = f"{cell.partition(':')[0]}: {check.known}" if known else cell
    return [check.file, f"{check.package} {version_of(check.environment, check.package)}", cell]


EXAMPLES = {
    "optuna": "search",
    "pettingzoo": "pettingzoo",
    "ray[rllib]": "rllib",
    "tianshou": "tianshou",
    "torchrl": "torchrl",
}
"""Tests of `tests/examples` that need a library, by the word that selects them."""


def check_learning(only: str) -> Iterator[tuple[list[str], bool]]:
    for pin in PINS["learning"]:
        name, _, version = pin.partition("==")
        library = name.removesuffix("[create,hdf5]")
        client = ("pytest", EXAMPLES[library]) if library in EXAMPLES else ("learning.py", library)
        if library in ("lidarnaut", "gymnasium", "pytest", "torch", "tensordict") or only not in f"learning {library}":
            continue
        cell = outcome(lambda client=client: run("learning", *client) and "", "runs")
        yield [library, version, cell], cell.startswith(("runs", "skipped"))


def check_inputs(files: Files, only: str) -> Iterator[tuple[list[str], bool]]:
    for name, door in DOORS.items():
        if only not in f"inputs {name}":
            continue
        found: list[Input] = []
        why = outcome(lambda door=door, found=found: found.extend(door(files)) or "", "")
        if why:
            yield [name, "all", why], why.startswith("skipped")
        for one in found:
            right = "refused in one line" if one.is_refused else "read"
            cell = outcome(lambda one=one: guarded(one), right)
            yield [one.door, one.name, cell], cell == right


def guarded(one: Input) -> str:
    try:
        return one.read()
    except Exception as error:  # any error is a wrong answer to a valid file
        return f"{type(error).__name__}: {error}"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.outside", description=__doc__)
    parser.add_argument(
        "--only", default="", help="word of the file, tool, `learning` or `inputs`: a part of the table"
    )
    parser.add_argument("--write", type=Path, help="page that gets the tables")
    options, started, wrong, text = parser.parse_args(), time.monotonic(), 0, INTRODUCTION
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder))
        parts = (
            ("", ("file", "tool", "result"), check_files(files, options.only)),
            (CLIENTS, ("library", "version", "result"), check_learning(options.only)),
            (INPUTS, ("reader", "written by", "result"), check_inputs(files, options.only)),
        )
        for introduction, head, rows in parts:
            text += f"\n{introduction}\n" if introduction else "\n"
            text += f"| {' | '.join(head)} |\n|{'---|' * len(head)}\n"
            for row, is_right in rows:
                line = f"| {' | '.join(cell.replace(folder, '').replace('|', '/') for cell in row)} |\n"
                print(("" if is_right else "WRONG ") + line, end="", flush=True)
                text, wrong = text + line, wrong + (not is_right)
    print(f"{wrong} cells are wrong; {time.monotonic() - started:.0f} s")
    if options.write:
        options.write.write_text(text.replace("\n\n\n", "\n\n"))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
