import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lidarnaut.envs.compilation import sources

ROOT = Path(__file__).parents[1]
FILES = {
    "constants": "FACTOR = 2\n",
    "inner": "from numba import njit\n\nfrom lidarnaut.envs.constants import FACTOR\n\n\n"
    "@njit(cache=True)\ndef scale(x):\n    return FACTOR * x\n",
    "outer": "from numba import njit\n\nfrom .inner import (\n    scale,\n)\n\n\n"
    "@njit(cache=True)\ndef shifted(x):\n    return scale(x) + 1\n",
    "other": "from numba import njit\n\n\n@njit(cache=True)\ndef same(x):\n    return x\n",
}
PROGRAM = """
import lidarnaut.envs.compilation
from lidarnaut.envs.outer import shifted
from lidarnaut.envs.other import same
print(shifted(3), same(3), sum(shifted.stats.cache_hits.values()), sum(same.stats.cache_hits.values()))
"""


@pytest.fixture
def checkouts(tmp_path):
    """Return two checkouts of a project that is as small as can be."""
    for name in ("first", "second"):
        folder = tmp_path / name / "lidarnaut" / "envs"
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()
        shutil.copy(ROOT / "envs" / "compilation.py", folder)
        for module, text in {"__init__": "", **FILES}.items():
            (folder / f"{module}.py").write_text(text)
    return tmp_path / "first", tmp_path / "second"


@pytest.fixture
def checkout(checkouts):
    return checkouts[0]


def run(checkout, program=PROGRAM, **variables):
    """Run a program there with a cache beside it, and return what it prints to standard output and error."""
    environment = {"PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(checkout.parent / "cache"), **variables}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=checkout, capture_output=True, text=True, check=True
    )
    return done.stdout.split(), done.stderr


def test_kernels_are_compiled_once_for_all_checkouts_and_that_is_announced(checkouts):
    first, second = checkouts
    result, said = run(first)
    assert result == ["7", "3", "0", "0"]
    assert said.count("compiling kernels for this machine") == 1
    os.utime(second / "lidarnaut" / "envs" / "inner.py", (0, 0))
    assert run(second) == (["7", "3", "1", "1"], "")


@pytest.mark.parametrize(
    ("module", "old", "new", "result"), [("constants", "2", "5", "16"), ("inner", "FACTOR *", "1 + 4 *", "14")]
)
def test_an_edit_compiles_what_depends_on_it_and_nothing_else(checkouts, module, old, new, result):
    first, second = checkouts
    run(first)
    path = second / "lidarnaut" / "envs" / f"{module}.py"
    path.write_text(path.read_text().replace(old, new))
    assert run(second)[0] == [result, "3", "0", "1"]
    assert run(first)[0] == ["7", "3", "1", "1"]


def test_records_that_kernels_take_may_move_to_another_module(checkout):
    record = "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    x: int\n"
    program = (
        "import lidarnaut.envs.compilation\nfrom lidarnaut.envs.{0} import Pair\n"
        "from lidarnaut.envs.other import same\nprint(same(Pair(3)).x)"
    )
    for module in ("records", "numbers"):
        (checkout / "lidarnaut" / "envs" / f"{module}.py").write_text(record)
        assert run(checkout, program.format(module))[0] == ["3"]
        (checkout / "lidarnaut" / "envs" / f"{module}.py").unlink()


def test_a_cache_that_cannot_be_written_is_done_without(checkout):
    assert run(checkout, XDG_CACHE_HOME="/dev/null")[0] == ["7", "3", "0", "0"]
    assert list((checkout / "lidarnaut" / "envs" / "__pycache__").glob("outer.*.nbi"))


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
def test_of_processes_that_need_a_kernel_at_once_one_compiles_it(checkout):
    environment = {"PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(checkout.parent / "cache")}
    command = [sys.executable, "-c", PROGRAM]
    runs = [
        subprocess.Popen(command, env=environment, cwd=checkout, stdout=subprocess.PIPE, text=True) for _ in range(4)
    ]
    printed = [run.communicate()[0].split() for run in runs]
    assert [words[:2] for words in printed] == [["7", "3"]] * 4
    for hits in zip(*(words[2:] for words in printed), strict=True):
        assert sorted(hits) == ["0", "1", "1", "1"]


@pytest.mark.skipif(os.name == "nt", reason="there are no such terminals")
def test_a_terminal_shows_how_many_kernels_have_been_compiled(checkout):
    ours, theirs = os.openpty()
    pytest.importorskip("termios").tcsetwinsize(theirs, (24, 80))
    environment = {"PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(checkout)}
    command = [sys.executable, "-c", PROGRAM]
    subprocess.run(command, env=environment, cwd=checkout, stdout=subprocess.DEVNULL, stderr=theirs, check=True)
    shown = os.read(ours, 100_000).decode()
    assert "compiling: 0 kernels [00:0" in shown
    assert shown.rstrip(" ").endswith("\r")  # the line is cleared


def test_user_kernels_are_kept_where_numba_keeps_them_and_announced_by_no_one(checkout):
    (checkout / "mine.py").write_text(FILES["other"])
    result, said = run(
        checkout, "import lidarnaut.envs.compilation, mine; print(mine.same(1), mine.same.stats.cache_path)"
    )
    assert result == ["1", str(checkout / "__pycache__")]
    assert said == ""


def test_all_kernels_are_kept_so():
    """Every file with kernels, or a package around it, imports the module that says where they are kept."""
    root = ROOT / "lidarnaut"
    wanted = str(root / "envs" / "compilation.py")
    files = [path for folder in ("agents", "baselines", "benchmarks", "envs") for path in (root / folder).rglob("*.py")]
    files = [path for path in files if "cache=True" in path.read_text(encoding="utf-8")]
    assert len(files) > 50
    for path in files:
        packages = [folder / "__init__.py" for folder in path.parents if (folder / "__init__.py").exists()]
        assert any(wanted in sources(str(one)) for one in (path, *packages)), path
