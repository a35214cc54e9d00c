import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

import evaluate
import train
from envs.command_line import Count, run_command

ROOT = Path(__file__).parents[1]


def measure(episodes: Count = 3, path: str = ""):
    """Write so many episodes to a path."""
    Path(path).write_text(str(episodes))


@pytest.mark.parametrize("count", ["0", "-1", "1.5", "nan", ""])
def test_counts_begin_at_one(capsys, count):
    with pytest.raises(SystemExit) as stop:
        run_command(measure, ["--episodes", count])
    assert stop.value.code == 2
    assert "--episodes" in capsys.readouterr().err


def test_a_file_that_cannot_be_written_is_one_line(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        run_command(measure, ["--path", str(tmp_path)])
    assert stop.value.code == 2
    assert capsys.readouterr().err.partition(": ")[2] == f"[Errno 21] Is a directory: '{tmp_path}'\n"


@dataclass(frozen=True)
class Options:
    folder: Annotated[Path, tyro.conf.Positional]
    """Where."""
    kind: Literal["slow", "fast"] = "fast"
    """How."""
    bounds: tuple[float, float] | None = None


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "missing: PATH"),
        (["a", "--knid", "slow"], "Unrecognized options: --knid, slow; Perhaps you meant: --kind {slow,fast}"),
        (["a", "--kind", "big"], "invalid choice 'big' for argument '--kind'. Expected one of ('slow', 'fast')"),
        (["a", "--bounds", "1", "x"], "Error parsing --bounds: no type matching {None}|{FLOAT FLOAT} could be"),
    ],
)
def test_wrong_options_are_one_plain_line(arguments, says, encoding, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    with pytest.raises(SystemExit) as stop:
        run_command(print, arguments, options=Options)
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not set("│─╭╰\x1b") & set(said)
    assert "----" not in said


@pytest.mark.parametrize(
    ("main", "wrong", "says"),
    [
        (
            train.main,
            ["--num-envs", "0"],
            "rooms_small.yaml: num_envs: Input should be greater than or equal to 1, got 0",
        ),
        (
            train.main,
            ["--evaluation.evry", "1"],
            "rooms_small.yaml: unknown key 'evaluation.evry' (did you mean 'every'?)",
        ),
        (train.main, ["--ppo.gamma", "1"], "rooms_small.yaml: unknown key 'ppo'; allowed are experiment, total_steps"),
        (train.main, ["rooms"], "unknown argument 'rooms'; options begin with --"),
        (evaluate.main, ["--episodes", "0"], "episodes: Input should be greater than or equal to 1, got 0"),
    ],
)
def test_wrong_settings_are_one_plain_line_under_the_name_that_was_called(main, wrong, says, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/lidarnaut-command"])
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)
    options = {train.main: ["--config", "rooms_small"], evaluate.main: ["--config", "arena", "--out", "runs/none"]}
    assert main([*options[main], *wrong]) == 2
    said = capsys.readouterr().err
    assert said.startswith("lidarnaut-command: ")
    assert says in said
    assert said.count("\n") == 1


def test_a_file_that_is_run_by_its_path_ends_with_a_message_too(tmp_path):
    program = ROOT / "benchmarks/films.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, program, "--policy"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert (done.returncode, "films.py: " in done.stderr, "Traceback" in done.stderr) == (2, True, False)


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["benchmarks.drives", "planning", "--worlds", "atlantis"], "benchmarks.drives: unknown world 'atlantis'"),
        (["agents.ship", "/no/such/run", "/no/such/folder"], "agents.ship: /no/such/run is no folder"),
    ],
)
def test_commands_end_with_a_message(command, says):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 2
    assert says in " ".join((done.stdout + done.stderr).split())
    assert "Traceback" not in done.stderr
