import os
import subprocess
import sys
from pathlib import Path

import pytest

from envs.command_line import Count, run_command

ROOT = Path(__file__).parents[1]


def measure(episodes: Count = 3, path: str = ""):
    """Write so many episodes to a path."""
    Path(path).write_text(str(episodes))


def test_a_function_is_called_with_the_options(tmp_path):
    run_command(measure, ["--episodes", "7", "--path", str(tmp_path / "a")])
    assert (tmp_path / "a").read_text() == "7"


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
    assert capsys.readouterr().err == f"tests.test_command_line: [Errno 21] Is a directory: '{tmp_path}'\n"


def test_a_file_that_is_run_by_its_path_ends_with_a_message_too(tmp_path):
    program = ROOT / "benchmarks/time_ratios.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, program, tmp_path / "none"], capture_output=True, text=True, env=environment)
    assert (done.returncode, "time_ratios: " in done.stderr, "Traceback" in done.stderr) == (2, True, False)


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["benchmarks.time_ratios", "/no/such/folder"], "benchmarks.time_ratios: [Errno 2] No such file or directory"),
        (["benchmarks.navigation", "--worlds", "atlantis"], "benchmarks.navigation: unknown world 'atlantis'"),
        (["agents.ship", "/no/such/run", "/no/such/folder"], "agents.ship: /no/such/run is no folder"),
    ],
)
def test_commands_end_with_a_message(command, says):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 2
    assert says in " ".join((done.stdout + done.stderr).split())
    assert "Traceback" not in done.stderr
