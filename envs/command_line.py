"""Command lines of functions, whose mistakes end in a message, and the console that tables are printed on."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console


def _read_count(texts: list[str]) -> int:
    count = int(texts[0])
    if count < 1:
        raise ValueError(f"must be at least 1, got {count}")
    return count


Count = Annotated[
    int,
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="COUNT",
        instance_from_str=_read_count,
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda count: [str(count)],
    ),
]
"""A whole number from 1."""


def run_command(main: Callable[..., Any], arguments: list[str] | None = None) -> Any:
    """Call a function with the options of the command line, which are its arguments, and return what it returns.

    Args:
        main: the function; the documentation of its module is shown as help.
        arguments: options; None takes those of the process.

    Raises:
        SystemExit: with status 2, if an option is wrong, or the function raises ValueError, RuntimeError or OSError,
            such as for a missing file; says what.
    """
    spec = sys.modules["__main__"].__spec__
    program = spec.name if spec else Path(sys.argv[0]).stem  # run by its path, a file has no specification
    name = (main.__module__ if main.__module__ != "__main__" else program).removesuffix(".__main__")
    try:
        return tyro.cli(
            main, prog=f"python -m {name}", description=sys.modules[main.__module__].__doc__, args=arguments
        )
    except (ValueError, RuntimeError, OSError) as error:
        sys.stderr.write(f"{name}: {error}\n")
        sys.exit(2)


def make_console() -> Console:
    """Return a console on the standard output: as wide as the terminal, or as any table where there is none."""
    return Console(width=None if sys.stdout.isatty() else 180)
