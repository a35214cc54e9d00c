"""Command-line interfaces that are generated from functions."""

import contextlib
import functools
import io
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import tyro
from pydantic import ValidationError
from rich.console import Console
from rich.text import Text

from lidarnaut.envs.files import explain_errors, printable


def _read_count(texts: list[str]) -> int:
    count = int(texts[0])
    if count < 1:
        raise ValueError(f"must be at least 1, got {count}")
    return count


Count = Annotated[
    int,
    tyro.constructors.PrimitiveConstructorSpec(
        1, "COUNT", _read_count, lambda value: isinstance(value, int), lambda count: [str(count)]
    ),
]
"""Command-line option for a positive integer."""


def program_name() -> str:
    """Return the program name as the user called it."""
    spec = sys.modules["__main__"].__spec__  # None if run by its path
    return f"python -m {spec.name.removesuffix('.__main__')}" if spec else Path(sys.argv[0]).name


class _Output(io.FileIO):
    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            return memoryview(data).nbytes


def begin_command(arguments: Sequence[str] | None = None) -> list[str]:
    """Return the command-line options, by default those of the process, which SIGTERM then ends like Ctrl-C.

    `--version` prints the version and exits.
    """
    if arguments is None:
        if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _interrupt)
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name) or open(os.devnull, "w")  # noqa: SIM115
            if stream is getattr(sys, f"__{name}__") and not stream.isatty():
                file = io.BufferedWriter(_Output(stream.fileno(), "w", closefd=False))
                stream = io.TextIOWrapper(file, stream.encoding, stream.errors, line_buffering=True)
            setattr(sys, name, stream)
        arguments = sys.argv[1:]
    if "--version" in arguments:
        sys.stdout.write(f"{program_name()} {sys.modules['lidarnaut'].__version__}\n")
        sys.exit()
    return list(arguments)


def _interrupt(number: int, frame: Any) -> None:
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # background jobs of a script ignore Ctrl-C
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def fail(error: object) -> int:
    """Print an error to standard error; return exit status 2."""
    sys.stderr.write(f"{program_name().removeprefix('python -m ')}: {printable(error)}\n")
    return 2


def parse_options(kind: Any, arguments: Sequence[str] | None = None, **how: Any) -> Any:
    """Parse a command line by `tyro.cli(**how)`; ValueError if an option or a value of a pydantic model is invalid."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            options = tyro.cli(kind, args=arguments, prog=program_name(), **how)
    except (SystemExit, ValidationError) as stop:
        if isinstance(stop, SystemExit) and stop.code != 2:
            raise
        message, cause = _in_a_line(said.getvalue()), stop.__context__
        chain = stop, cause, cause and cause.__context__
        if fault := next((one for one in chain if isinstance(one, ValidationError)), None):
            section = message.partition("Error parsing ")[2].partition(":")[0]
            section = "" if section in ("", fault.title) else f"{section}."
            message = "\n".join(section + line for line in explain_errors(fault, kind))
        raise ValueError(message) from None
    sys.stderr.write(said.getvalue())
    return options


def _in_a_line(box: str) -> str:
    """Return the paragraphs of a message of tyro in one line, without its frame, types that failed and hint at help."""
    paragraphs = [""]
    for row in Text.from_ansi(box).plain.splitlines()[1:-1]:
        words = row.strip("│| ")
        if words.strip("─-"):
            paragraphs[-1] += f" {words}"
        else:
            paragraphs.append("")
    told = (one.strip(" .") for one in paragraphs if not one.startswith((" Got errors", " For full helptext")))
    return "; ".join(filter(None, told))


def run_command(
    main: Callable[..., Any], arguments: list[str] | None = None, options: Any = None, status: int = 2, **how: Any
) -> Any:
    """Call a function with arguments from the command line; return its result, or exit on errors.

    Args:
        main: function; the docstring of its module is the help text.
        arguments: command line; None for that of the process.
        options: class of the argument of `main`; None for several arguments.
        status: exit status after errors of `main`.
        how: further arguments of `tyro.cli`.
    """
    arguments = begin_command(arguments)
    show_log("lidarnaut.agents")
    later = functools.wraps(main)(lambda *args, **kwargs: functools.partial(main, *args, **kwargs))
    try:
        read = parse_options(options or later, arguments, description=sys.modules[main.__module__].__doc__, **how)
    except ValueError as error:
        sys.exit(fail(error))
    try:
        return main(read) if options else read()
    except (ValueError, RuntimeError, OSError, ImportError, gymnasium.error.Error) as error:
        fail(error)
        sys.exit(status)


def show_log(name: str = "lidarnaut") -> None:
    """Print messages of the package's loggers below `name` to standard error, from level INFO on."""
    logging.basicConfig(format="%(name)s: %(message)s")
    logging.getLogger(name).setLevel(logging.INFO)


def make_console() -> Console:
    """Return a console on standard output, 180 columns wide if it is not a terminal."""
    return Console(width=None if sys.stdout.isatty() else 180)


def plus_minus(value: float, digits: int) -> str:
    """Return an uncertainty as text, such as `+- 0.02`, or `+- < 0.01`: a small one is not none."""
    return f"+- {value:.{digits}f}" if value >= 0.5 * 10.0**-digits else f"+- < {10.0**-digits:.{digits}f}"
