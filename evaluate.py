"""Compare policies in the same worlds with the same seeds.

python evaluate.py --policies ppo:runs/RUN my_package.explorers:Mine --worlds turtlebot3_house rooms --out runs/a
python evaluate.py --id lidarnaut/Navigate-v0 --policies pursuit dwb random --arguments.localizer truth --out runs/b
python evaluate.py --config configs/arena.yaml --jobs 2 --out runs/arena --publish docs/results

The same command resumes an interrupted evaluation.
"""

import argparse
import shlex
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
import yaml
from rich.console import Console

from lidarnaut.agents.config import find_configuration
from lidarnaut.benchmarks.arena.conditions import FinishedEvaluation
from lidarnaut.benchmarks.arena.publish import print_results, publish, run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs.command_line import begin_command, fail, parse_options, show_log
from lidarnaut.envs.files import naming, own_folder, read_record

FINISHED = Settings(policies=("of the folder",))
"""Settings of `--report` alone."""


@dataclass(frozen=True)
class Command:
    """Command-line options of an evaluation."""

    settings: Annotated[Settings, tyro.conf.arg(name="")]
    """Settings of the evaluation."""
    out: Path
    """Folder for the results."""
    config: str | None = None
    """YAML file with settings, or `arena` from the package; options of the command line override its settings."""
    jobs: int = 1
    """Number of processes; decision times are most accurate with at most one per core."""
    shard: str | None = None
    """Run only part I of N, given as `I/N`, without a report; parts may share the folder."""
    trust: tuple[str, ...] = ()
    """Modules of your own, or `module:attribute`, that learned policies may use."""
    bags: Path | None = None
    """Folder for a ROS 2 bag (MCAP) of each new episode."""
    record: bool = False
    """Record each new episode; the report links to pages that play the recordings."""
    report: bool = False
    """Publish the results in the folder without running episodes; without `--policies`, all that it holds."""
    reference: str = ""
    """Policy that the report compares the others with; by default `nearest`, `pursuit` or another classic one."""
    publish: Path | None = None
    """Folder of Markdown pages, such as `docs/results`, for the leaderboard as `arena.md` and `arena/`."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Log the progress of each episode every 10 s: explored share, goal, number of blacklisted goals."""


def main(arguments: list[str] | None = None) -> int:
    """Read the command line, evaluate and publish; return the exit status."""
    arguments = begin_command(arguments)
    show_log("lidarnaut.agents")
    messages = Console(stderr=True)
    command: Command | None = None
    try:
        command = read_command(arguments)
        evaluation: Evaluation | FinishedEvaluation
        if command.settings.policies == FINISHED.policies:
            if command.settings != FINISHED or command.shard:
                raise ValueError("--report without --policies shows all results of the folder, and takes no settings")
            evaluation = FinishedEvaluation(command.out)
        else:
            evaluation = Evaluation(command.settings, command.out, command.shard, trust=command.trust)
        failures = []
        if command.publish and command.shard is None:
            # Fail before the first episode if the folder is not writable.
            pictures = own_folder(command.publish, "arena")
            with naming(pictures), tempfile.TemporaryFile(dir=pictures):
                pass
        if command.verbose:
            show_log()
        if not command.report and isinstance(evaluation, Evaluation):
            how = {"bags": command.bags, "record": command.record}
            failures = run_with_progress(evaluation, command.jobs, messages, **how)
        if command.shard is not None:
            messages.print(f"Shard {command.shard} is done; run the same command without --shard to publish.")
            return 1 if failures else 0
        publish(evaluation, shown_command(arguments, command), command.publish, command.reference)
    except KeyboardInterrupt:
        messages.print("Interrupted. Finished episodes are kept; run the same command to resume.")
        return 130
    except (ValueError, RuntimeError, ImportError, OSError) as error:
        is_bare = isinstance(error, OSError) and error.errno is not None and error.filename is None
        if command and is_bare:  # full disk: no path given
            return fail(f"{error} (while writing to {command.out})")
        return fail(error)
    print_results(evaluation, messages, command.reference)
    return 1 if evaluation.missing() else 0


def read_command(arguments: list[str]) -> Command:
    """Parse a command line; options replace the settings of `--config`. With `--report` alone, these are `FINISHED`."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--config")
    first.add_argument("--policies")
    first.add_argument("--report", action="store_true")
    known = first.parse_known_args(arguments)[0]
    settings: Any = tyro.MISSING
    if known.config is not None:
        settings = read_record(find_configuration(known.config, "policies"), Settings)
    elif known.report and known.policies is None:
        settings = FINISHED
    words, further = split_arguments(arguments)
    command = parse_options(Command, words, default=Command(settings, out=tyro.MISSING), description=__doc__)
    further = {**command.settings.arguments, **further}
    return replace(command, settings=command.settings.model_copy(update={"arguments": further}))


def split_arguments(words: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Separate options `--arguments.NAME VALUE` from a command line: return other words, and values by name."""
    rest, found, left = list[str](), dict[str, Any](), iter(words)
    for word in left:
        if not word.startswith("--arguments."):
            rest.append(word)
            continue
        name, equals, value = word.removeprefix("--arguments.").partition("=")
        if not equals and not (value := next(left, "")):
            raise ValueError(f"{word} needs a value")
        found[name.replace("-", "_")] = yaml.safe_load(value)
    return rest, found


def shown_command(arguments: Sequence[str], command: Command) -> str:
    """Return a command that reproduces the results, without private paths of this machine.

    An absolute output folder outside the current folder becomes `runs/NAME`.
    """
    shown = shlex.join(argument for argument in arguments if argument != "--report").replace(f"{Path.cwd()}/", "")
    if command.out.is_absolute() and not command.out.is_relative_to(Path.cwd()):
        name = Path(command.config).stem if command.config else command.out.name
        shown = shown.replace(str(command.out), f"runs/{name}")
    return f"python evaluate.py {shown}"


if __name__ == "__main__":
    sys.exit(main())
