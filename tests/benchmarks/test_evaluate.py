import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lidarnaut.benchmarks.arena import overview, workers
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.arena.trace import Recorder
from lidarnaut.envs.estimation import MapUpdate
from lidarnaut.envs.files import Lock
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.evaluate_command import main
from tests.benchmarks.explorations import MEASURES, deterministic, read_rows

ROOT = Path(__file__).parents[2]
WORLD = "turtlebot3_world"
BRIEF = ("--episodes", "2", "--physics", "kinematic", "--time-limit", "4")
NAVIGATE, CHOOSE = (
    ["--worlds", "usual", "--id", f"lidarnaut/{name}-v0", "--policies"] for name in ("Navigate", "ExploreFrontiers")
)


def test_the_command_leaves_table_summary_and_the_same_report_for_one_world_or_two(tmp_path, capsys, monkeypatch):
    drawn = []
    monkeypatch.setattr(overview, "render", lambda draw, *arguments: drawn.append((draw.__name__, *arguments)) or b"")
    options = ["--policies", "random", "nearest", *BRIEF, "--out", str(tmp_path), "--worlds", WORLD]
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert all(f"{measure.title} " in printed for measure in MEASURES.brief)
    check_report(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {policy: list(worlds) for policy, worlds in summary.items()} == {"random": [WORLD], "nearest": [WORLD]}
    for measures in (summary["random"][WORLD], summary["nearest"][WORLD]):
        assert list(measures) == [measure.name for measure in MEASURES.all]
        for value in measures.values():
            assert list(value) == ["iqm", "low", "high", "n", "never"]
            assert value["low"] <= value["iqm"] <= value["high"]
            assert value["n"] == 2
    never = {"iqm": 4.0, "low": 4.0, "high": 4.0, "n": 2, "never": 2}
    assert summary["random"][WORLD]["time_to_99"] == never
    rows = read_rows(tmp_path)
    assert len(rows) == 4
    assert {row["time_to_99"] for row in rows} == {row["distance_to_95"] for row in rows} == {"inf"}

    # With one more world and a lost row, only these episodes are run, and the lost row is reproduced.
    table = (tmp_path / "episodes.csv").read_text().splitlines(keepends=True)
    (tmp_path / "episodes.csv").write_text("".join(table[:-1]))
    assert main([*options, "maze"]) == 0
    printed = capsys.readouterr().out
    assert "path m" not in printed
    again = read_rows(tmp_path)
    assert len(again) == 8
    assert again[:3] == rows[:3]
    assert deterministic(again[3:4]) == deterministic(rows[3:])
    check_report(tmp_path)
    curves = [(one[1][-1], one[3]) for one in drawn if one[0] == "draw_bands"]
    assert curves[0] == (4.0, "time [s]")
    assert curves[-2] == (2.0, "time, as a share of nearest's to 95 %")


def check_report(folder):
    report, page = (folder / "report.html").read_text(), (folder / "leaderboard.md").read_text()
    Balanced().feed(report)
    titles = re.findall(r"<h2>(.+)</h2>", report)
    assert titles == re.findall(r"(?m)^## (.+)", page)
    assert titles[:4] == ["At a glance", "Leaderboard", "Curves", "World by world"]
    assert titles[-1] == "Conditions"
    assert "Policy" not in report  # without weights and arguments, there is nothing to say
    assert "never<small>&gt; 4 s</small>" in report
    assert report.count("<figure") == page.count("![") == 2 + 2 * 2
    assert not re.search(r'(src|href|srcset)="(?!data:image/)', report)


class Balanced(HTMLParser):
    """Fails if a closed tag is not the innermost open one."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "source"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (["--policies", "rrandom"], ["'rrandom'", "random, nearest, frontier", "ppo:PATH"]),
        (["--policies", "ppo:no/such/run"], ["no/such/run"]),
        (["--policies", "random", "random"], ["unique"]),
        (["--worlds", "maze", "atlantis"], ["'atlantis'", "turtlebot3_world", "rooms"]),
        (["--worlds", "home=a.yaml", "home=b.yaml"], ["worlds", "unique"]),
        (["--worlds", "maze=a.yaml"], ["LABEL=PATH"]),
        (["--robot", "r2d2"], ["'r2d2'", "turtlebot3_burger"]),
        (["--robot", "tugbot", "--worlds", "pimouse_arena"], ["'tugbot'", "pimouse_arena"]),
        (["--physics", "mujoco"], ["'mujoco'", "kinematic"]),
        (["--worlds", "os:path"], ["world 'os:path' must name a World"]),
        (["--slam"], ["Tuple should have at least 1 item"]),
        (["--shard", "3/2"], ["shard", "'3/2'", "I/N"]),
        (["--jobs", "0"], ["jobs", "at least 1"]),
        (["--publish", __file__], ["Not a directory", "test_evaluate.py/arena"]),
        ([*NAVIGATE, "nearest"], ["allowed are pursuit, pursuit:fast, dwb, dwb:agv, mppi, random"]),
        ([*NAVIGATE, "persuit"], ["'persuit' (did you mean 'pursuit'?)"]),
        ([*NAVIGATE, "random", "--arguments.goal_tolerance", "-1"], ["goal_tolerance must be positive, got -1"]),
        (["--policies", "rrt_team"], ["'rrt_team' cannot do this task; allowed are random, nearest"]),
        ([*CHOOSE, "rrt"], ["'rrt' cannot do this task; allowed are random, nearest, frontier"]),
        ([*CHOOSE, "ppo:pretrained/twist"], ["twists, but lidarnaut/ExploreFrontiers-v0 takes"]),
        (["--id", "lidarnaut/Naviate-v0"], ["'lidarnaut/Naviate-v0' (did you mean 'lidarnaut/Navigate-v0'?)"]),
        (["--id", "nowhere:mine/Goal-v0"], ["id 'nowhere:mine/Goal-v0': there is no module 'nowhere'"]),
    ],
)
def test_wrong_names_fail_before_any_work(tmp_path, capsys, wrong, says):
    assert main([*BRIEF, "--policies", "random", "--worlds", "maze", "--out", str(tmp_path / "out"), *wrong]) == 2
    message = " ".join("".join(capsys.readouterr()).split())
    assert all(text in message for text in says), message
    assert not list((tmp_path / "out").glob("episodes/*"))


def test_times_stay_under_their_cells_when_a_redrawn_map_has_other_borders():
    grid = OccupancyGrid(np.full((4, 6), -1, dtype=np.int8), 0.5, (0.0, 0.0))
    belief = SimpleNamespace(pose=Pose2D(0.0, 0.0, 0.0), grid=grid, update=None)
    recorder = Recorder(SimpleNamespace(belief=belief, robots=[None]))

    def watch(time, data, origin):
        grid.data, grid.origin = np.array(data, dtype=np.int8), origin
        belief.update = MapUpdate(np.argwhere(grid.data >= 0).astype(np.int32), None, True, origin)
        recorder.watch({"time": time})

    watch(1.0, [[-1, -1, -1], [-1, 0, -1]], (0.0, 0.0))
    watch(2.0, [[-1, -1, -1, -1], [-1, -1, 0, 100], [-1, -1, -1, -1]], (-0.5, 0.0))  # one more column to the left
    watch(3.0, [[0, 100], [0, -1]], (0.5, 0.5))  # the lowest row and two columns are gone
    np.testing.assert_array_equal(recorder._known_since, [[1.0, 2.0], [3.0, np.inf]])


def test_a_folder_alone_is_reported_with_its_conditions(tmp_path, capsys, no_overview):
    options = ["--policies", "random", "nearest", "--worlds", WORLD, *BRIEF, "--out", str(tmp_path)]
    assert main([*options, "--people", "2?attentive=0.5"]) == 0
    first = (tmp_path / "leaderboard.md").read_text()
    for fact in (
        "| Environment | lidarnaut/Explore-v0",
        "| Success | 99 % is explored",
        "| Lidar of turtlebot3\\_burger | 360 beams over 360 degrees, 0.12 to 3.5 m",
        "attentive 0.5",
        f"| World turtlebot3\\_world | {BRIEF[1]} starts, seeds 0 to 1; time limit 4 s",
        "| Estimator hector | ",
        "| Versions | commit ",
    ):
        assert fact in first, fact
    capsys.readouterr()
    assert main(["--report", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "random" in printed
    again = (tmp_path / "leaderboard.md").read_text()
    assert again.partition("| Command")[0] == first.partition("| Command")[0]
    assert main(["--report", "--out", str(tmp_path), "--reference", "random"]) == 0
    assert "Ratios are to random's." in (tmp_path / "leaderboard.md").read_text()
    for wrong, says in (
        (["--reference", "rrt"], "reference 'rrt' has no episode; choose one of random, nearest"),
        (["--episodes", "3"], "takes no settings"),
    ):
        assert main(["--report", "--out", str(tmp_path), *wrong]) == 2
        assert says in capsys.readouterr().err
    (tmp_path / "conditions.json").unlink()
    assert main(["--report", "--out", str(tmp_path)]) == 2
    assert "holds no conditions.json" in capsys.readouterr().err


def test_episodes_without_traces_leave_out_their_figures(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "out")
    shutil.rmtree(folder / "episodes")
    assert main(["--report", "--out", str(folder)]) == 0
    page = (folder / "leaderboard.md").read_text()
    assert "## Leaderboard" in page
    assert "![" not in page
    assert "## Typical and worst episodes" not in page


def test_a_second_evaluation_of_a_folder_says_that_there_is_a_first(tmp_path, capsys):
    options = ["--policies", "random", "--worlds", WORLD, *BRIEF, "--out", str(tmp_path)]
    settings = Settings(policies=("random",), worlds=(WORLD,), episodes=2, physics=("kinematic",), time_limit=4.0)
    late = Evaluation(settings, tmp_path)  # created before the next line's runs
    assert main([*options, "--shard", "1/1"]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {".lock", "conditions.json", "episodes", "episodes.csv", "settings.json"}  # a shard has no report
    assert late.run() == []
    assert len(read_rows(tmp_path)) == 2
    with Lock(tmp_path):
        for more in ([], ["--shard", "1/2"]):
            assert main([*options, *more]) == 2
            said = "".join(capsys.readouterr().err.split())
            assert f"{tmp_path}isinuse:process{os.getpid()}on" in said
    with Lock(tmp_path, shared=True), Lock(tmp_path, "lock-1of2"):
        assert main([*options, "--shard", "2/2"]) == 0
        assert main([*options, "--shard", "1/2"]) == 2
    assert len(read_rows(tmp_path)) == 2


def test_a_full_disk_is_named_and_the_same_command_goes_on(tmp_path, capsys):
    options = ["--policies", "random", "--worlds", WORLD, *BRIEF, "--out", str(tmp_path), "--shard", "1/1"]

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    main([*options, "--episodes", "1"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert main(options) == 2
    said = "".join(capsys.readouterr().err.split())
    assert f"Nospaceleftondevice:'{tmp_path}/" in said
    assert main(options) == 0
    assert len(read_rows(tmp_path)) == 2
    assert not list(tmp_path.rglob("*.tmp"))


def test_ctrl_c_in_compiled_code_is_no_failed_episode(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise SystemError("CPUDispatcher returned a result with an exception set") from stop

    monkeypatch.setattr(workers, "run_episode", interrupted)
    assert main(["--policies", "random", "--worlds", WORLD, *BRIEF, "--out", str(tmp_path)]) == 130
    assert "Interrupted" in capsys.readouterr().err
    assert not (tmp_path / "failures.csv").exists()


INTERRUPTED = """
import os, signal, sys, threading

import lidarnaut.benchmarks.arena.workers as workers
from lidarnaut.evaluate_command import main

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored in the background of a script
    held, number = workers.interrupts_held, signal.Signals[sys.argv.pop(1)]

    def started():
        # Ctrl-C interrupts the whole group, SIGTERM the process alone.
        kill = (os.killpg, (0, number)) if number == signal.SIGINT else (os.kill, (os.getpid(), number))
        threading.Timer(0.1, *kill).start()
        return held()

    workers.interrupts_held = started
    sys.exit(main())
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signals of POSIX")
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_an_interrupt_while_workers_start_is_one_line(tmp_path, number):
    options = ["--policies", "random", "--worlds", WORLD, "--episodes", "40", "--jobs", "2", "--time-limit", "3600"]
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "interrupted.py"), number, *options, "--out", str(tmp_path / "out")],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120,
        start_new_session=True,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert "Interrupted. Finished episodes are kept" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("file", "damage", "says"),
    [
        ("conditions.json", lambda text: "", "not readable as JSON"),
        ("conditions.json", lambda text: "[]", "must be a mapping of keys to values, got list"),
        ("conditions.json", lambda text: '{"measures": [{"name": 1}]}', "key 'task' is missing"),
        (
            "conditions.json",
            lambda text: text.replace('"digits": 1', '"digits": "x"'),
            "digits: Input should be a valid int",
        ),
        ("conditions.json", lambda text: text.replace('"scale": 100.0', '"scale": NaN'), "has an invalid scale"),
        (
            "conditions.json",
            lambda text: text.replace('"time_limit"', '"x"', 1),
            "has an invalid scale, digits or limit",
        ),
        ("conditions.json", lambda text: text.replace('"progress"', '"x"', 1), "task must hold progress and success"),
        ("settings.json", lambda text: text.replace('"versions"', '"x"'), "versions: must be a mapping"),
        ("settings.json", lambda text: "[]", "must be a mapping"),
        ("episodes.csv", lambda text: text.replace(",0.0,", ",x,", 1), "row 2: damaged: could not convert"),
        ("episodes.csv", lambda text: re.sub(r",inf,", ",nan,", text, count=1), "row 2: damaged: nan is allowed"),
        ("episodes.csv", lambda text: re.sub(r",0,time", ",7,time", text, count=1), "7' is neither 0 nor 1"),
    ],
)
def test_a_damaged_file_of_a_folder_is_named_in_a_line(finished, tmp_path, capsys, file, damage, says):
    folder = shutil.copytree(finished, tmp_path / "out")
    before = (folder / file).read_text()
    (folder / file).write_text(after := damage(before))
    assert after != before
    assert main(["--report", "--out", str(folder)]) == 2
    said = capsys.readouterr().err
    assert file in said
    assert says in said
    assert len(said.splitlines()) == 1


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    assert main(["--policies", "random", "--worlds", WORLD, *BRIEF, "--out", str(folder)]) == 0
    return folder
