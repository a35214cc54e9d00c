import functools
import io
import os
import re
import runpy
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tyro

from lidarnaut import evaluate_command as evaluate
from lidarnaut import train_command as train
from lidarnaut.agents.config import find_configuration
from lidarnaut.envs import progress
from lidarnaut.envs.command_line import Count, run_command
from lidarnaut.envs.progress import Progress

ROOT = Path(__file__).parents[2]


def measure(episodes: Count = 3, path: str = ""):
    """Write episodes to a path."""
    Path(path).write_text(str(episodes))


def show(options):
    """Run the command line of `Options`."""


@dataclass(frozen=True)
class Options:
    folder: Annotated[Path, tyro.conf.Positional]
    """Folder."""
    kind: Literal["slow", "fast"] = "fast"
    """Kind."""
    bounds: tuple[float, float] | None = None


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize(
    ("function", "arguments", "says"),
    [
        *((measure, ["--episodes", count], "--episodes") for count in ("0", "-1", "1.5", "nan", "")),
        (measure, ["--path", "/"], ": [Errno 21] Is a directory: '/'\n"),
        (show, [], ": PATH Folder. (required)\n"),
        (show, ["a", "--knid", "slow"], "Unrecognized options: --knid, slow; Perhaps you meant: --kind {slow,fast}"),
        (
            show,
            ["a", "--kind", "big"],
            "invalid choice 'big' for argument '--kind'. Expected one of ('slow', 'fast')\n",
        ),
        (
            show,
            ["a", "--bounds", "1", "x"],
            "no type matching {None}|{FLOAT FLOAT} could be instantiated from ['1', 'x']; Arg",
        ),
    ],
)
def test_wrong_options_are_one_plain_line(function, arguments, says, encoding, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding))
    with pytest.raises(SystemExit) as stop:
        run_command(function, arguments, **({"options": Options} if function is show else {}))
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not set("│─╭╰\x1b") & set(said)
    assert "----" not in said


@pytest.mark.parametrize(
    ("main", "wrong", "says"),
    [
        (train.main, ["--num-envs", "0"], "rooms_small.yaml: num_envs: Input should be greater than or equal to 1"),
        (train.main, ["--evaluation.evry", "1"], "unknown key 'evaluation.evry' (did you mean 'every'?)"),
        (train.main, ["--ppo.gamma", "1"], "rooms_small.yaml: unknown key 'ppo'; allowed are experiment, seed"),
        (train.main, ["--config", "rooms_smal"], "did you mean 'rooms_small'"),
        (evaluate.main, ["--config", "arenas"], "did you mean 'arena'"),
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


DRIVES, FILMS = "lidarnaut.benchmarks.drives slam --drives atlantis:create3", f"{ROOT}/benchmarks/films.py --policy"


@pytest.mark.parametrize(("command", "says"), [(DRIVES, "drives: unknown world 'atlantis'"), (FILMS, "films.py: ")])
def test_commands_end_with_a_message(command, says, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", command.split())
    run = functools.partial(runpy.run_module, alter_sys=True) if command is DRIVES else runpy.run_path
    with pytest.raises(SystemExit) as stop:
        run(sys.argv[0], run_name="__main__")
    assert stop.value.code == 2
    assert says in " ".join("".join(capsys.readouterr()).split())


def test_commands_print_their_version(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/lidarnaut-evaluate"])
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)
    with pytest.raises(SystemExit) as stop:
        evaluate.main(["--version"])
    assert not stop.value.code
    assert re.fullmatch(r"lidarnaut-evaluate \d+\.\d+[\w.]*\n", capsys.readouterr().out)


@pytest.mark.skipif(os.name == "nt", reason="runs in bash")
def test_an_evaluation_goes_on_when_its_reader_has_gone(tmp_path):
    pytest.importorskip("torch", reason="the version of torch is recorded")
    options = "--policies random --worlds pimouse_arena --episodes 1 --physics kinematic --time-limit 1 --out out"
    command = f"{sys.executable} -m lidarnaut.evaluate_command {options}"
    line = f"{command} 2>&1 | true; exit ${{PIPESTATUS[0]}}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "out" / "report.html").exists()


def test_configurations_go_by_name_or_path(tmp_path, monkeypatch):
    assert find_configuration("explore_frontiers", "experiment") == ROOT / "configs" / "explore_frontiers.yaml"
    assert find_configuration("configs/mine.yaml", "experiment") == Path("configs/mine.yaml")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("experiment: mine\n")
    assert find_configuration("mine", "experiment") == Path("mine")
    names = {path.stem for path in (ROOT / "configs").glob("*.yaml")} - {"algorithms", "arena"} | {"ReachGoal-v0"}
    with pytest.raises(ValueError, match="did you mean 'explore_frontiers'") as error:
        find_configuration("explore_frontier", "experiment")
    said = set(str(error.value).replace(",", " ").split())
    assert names <= said
    assert not {"arena", "jackal_360", "room_12m"} & said


class Terminal(io.StringIO):
    def isatty(self):
        return True


def run_bars(file, monkeypatch, **options):
    """Run a bar of 40 items, one second each, with a nested bar for the tenth; return the output."""
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    monkeypatch.setattr(sys, "stderr", file)
    for k in Progress(range(40), desc="items", mininterval=0.0, **options):
        now += 1.0
        if k == 10:
            list(Progress(range(3), desc="parts", leave=False))
            Progress.write("a note", file=file)
    return file.getvalue()


def test_a_bar_stays_on_its_line_of_a_terminal_and_elsewhere_writes_whole_lines_now_and_then(monkeypatch):
    written = run_bars(Terminal(), monkeypatch)
    assert written.count("\r") > 40
    assert "40/40" in written.split("\r")[-1]
    written = run_bars(io.StringIO(), monkeypatch)
    assert not {"\r", "\x1b"} & set(written)
    assert written.endswith("\n")
    shares = [line.split("|")[0] for line in written.splitlines()]
    items = [f"items: {percent:3d}%" for percent in (0, 25, 50, 75, 100)]
    assert shares == [*items[:2], "parts:   0%", "parts: 100%", "a note", *items[2:]]
    for file in (io.StringIO(), Terminal()):
        monkeypatch.setattr(sys, "stderr", file)
        list(Progress(range(5), delay=60.0))
        list(Progress(range(5), disable=True))
        assert file.getvalue() == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked")
def test_a_process_that_is_killed_in_the_midst_of_a_bar_stops_no_other():
    program = "import os\nfrom lidarnaut.envs.progress import Progress\nlist(Progress(range(3)))\nchild = os.fork()\n"
    program += "if not child:\n    Progress.get_lock().acquire()\n    os._exit(9)\nos.waitpid(child, 0)\n"
    program += "list(Progress(range(3)))"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, timeout=20, check=True)


def test_names_in_bars_are_escaped(capsys):
    with Progress(total=1, desc="\x1b[2J") as bar:
        bar.set_postfix_str("\x1b]0;x\x07")
        bar.update()
    shown = capsys.readouterr().err
    assert "\x1b" not in shown
    assert r"\x1b[2J" in shown
    assert r"\x1b]0;x\x07" in shown
