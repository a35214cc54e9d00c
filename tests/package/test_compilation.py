import os
import pickle
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lidarnaut.envs.compilation import MAX_AGE

ROOT = Path(__file__).parents[2]
OWN = "from lidarnaut.envs.compilation import njit\n"
FILES = {
    "constants": "FACTOR = 2\n",
    "inner": f"{OWN}from lidarnaut.envs.constants import FACTOR\n\n\n"
    "@njit(cache=True)\ndef scale(x):\n    return FACTOR * x\n",
    "outer": f"{OWN}from .inner import (\n    scale,\n)\n\n\n"
    "@njit(cache=True)\ndef shifted(x):\n    return scale(x) + 1\n",
    "other": f"{OWN}\n\n@njit(cache=True)\ndef same(x):\n    return x\n",
}
PROGRAM = """
from lidarnaut.envs.outer import shifted
from lidarnaut.envs.other import same
print(shifted(3), same(3), sum(shifted.stats.cache_hits.values()), sum(same.stats.cache_hits.values()))
"""


def make_checkout(path):
    folder = path / "lidarnaut" / "envs"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()
    shutil.copy(ROOT / "envs" / "compilation.py", folder)
    for module, text in {"__init__": "", **FILES}.items():
        (folder / f"{module}.py").write_text(text)
    return path


@pytest.fixture
def checkout(tmp_path):
    return make_checkout(tmp_path / "first")


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """Return a cache folder with compiled kernels."""
    folder = tmp_path_factory.mktemp("warm")
    result, said = run(make_checkout(folder / "first"))
    assert result == ["7", "3", "0", "0"]
    assert said.count("compiling kernels for this machine") == 1
    return folder / "cache"


@pytest.fixture
def compiled(checkout, warm):
    """Return another checkout, with the cache folder."""
    shutil.copytree(warm, checkout.parent / "cache")
    return checkout


def start(checkout, program=PROGRAM, stderr=subprocess.PIPE, **variables):
    environment = {"PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(checkout.parent / "cache"), **variables}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # Python compares seconds and sizes of edited files with its own cache
    command = [sys.executable, "-c", program]
    return subprocess.Popen(command, env=environment, cwd=checkout, stdout=subprocess.PIPE, stderr=stderr, text=True)


def run(checkout, program=PROGRAM, **variables):
    process = start(checkout, program, **variables)
    printed, said = process.communicate()
    assert process.returncode == 0, said
    return printed.split(), said


def test_kernels_are_compiled_once_for_all_checkouts_and_after_an_edit_only_those_that_depend_on_it(compiled):
    folder = compiled / "lidarnaut" / "envs"
    os.utime(folder / "inner.py", (0, 0))
    assert run(compiled) == (["7", "3", "1", "1"], "")
    for module, old, new, result in (("constants", "2", "5", "16"), ("inner", "FACTOR *", "1 + 4 *", "14")):
        path = folder / f"{module}.py"
        path.write_text(path.read_text().replace(old, new))
        assert run(compiled)[0] == [result, "3", "0", "1"]
    for module in ("constants", "inner"):
        (folder / f"{module}.py").write_text(FILES[module])
    assert run(compiled)[0] == ["7", "3", "1", "1"]


def test_numba_and_kernels_of_other_packages_are_as_without_this_package(checkout):
    (checkout / "mine.py").write_text("import numba\n\n\n@numba.njit(cache=True)\ndef same(x):\n    return x\n")
    program = """
from numba.core import caching, config, dispatcher
def parts():
    return [dict(vars(one)) for one in (dispatcher.Dispatcher, caching.CacheImpl, caching.FunctionCache, config)]
before, locators = parts(), list(caching.CacheImpl._locator_classes)
from lidarnaut.envs.outer import shifted
import mine
print(shifted(3), mine.same(1), mine.same.stats.cache_path, parts() == before)
print(caching.CacheImpl._locator_classes == locators, shifted.stats.cache_path)
"""
    result, said = run(checkout, program)
    assert result[:5] == ["7", "1", str(checkout / "__pycache__"), "True", "True"]
    assert Path(result[5]).parent == checkout.parent / "cache" / "lidarnaut"
    assert len(said.splitlines()) == 1  # of the compilation of `shifted`


def test_folders_that_nobody_has_used_for_a_month_are_deleted(compiled, tmp_path):
    base = tmp_path / "cache" / "lidarnaut"
    used = set(base.iterdir())
    ages = {"lidarnaut.envs.other-0123456789abcdef": 1.1, "lidarnaut.envs.gone-0": 1.1, "lidarnaut.envs.other-1": 0.9}
    for name, age in {**ages, "references": 1.1}.items():
        (base / name).mkdir()
        os.utime(base / name, (time.time() - age * MAX_AGE,) * 2)
    for folder in used:
        os.utime(folder, (time.time() - 0.9 * MAX_AGE,) * 2)
    assert run(compiled)[0] == ["7", "3", "1", "1"]
    assert {path.name for path in base.iterdir()} - {path.name for path in used} == {*ages, "references"}
    assert min(folder.stat().st_mtime for folder in used) > time.time() - 0.5 * MAX_AGE
    (compiled / "lidarnaut" / "envs" / "constants.py").write_text("FACTOR = 3\n")
    assert run(compiled)[0] == ["10", "3", "0", "1"]
    assert {path.name for path in base.iterdir()} > {"lidarnaut.envs.other-1", "references", *(p.name for p in used)}
    assert not any((base / name).exists() for name, age in ages.items() if age > 1.0)


def test_records_that_kernels_take_may_move_to_another_module(checkout):
    record = "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    x: int\n"
    program = (
        "from lidarnaut.envs.{0} import Pair\nfrom lidarnaut.envs.other import same\n"
        "print(same(Pair(3)).x, sum(same.stats.cache_hits.values()))"
    )
    for module in ("records", "numbers"):
        (checkout / "lidarnaut" / "envs" / f"{module}.py").write_text(record)
        assert run(checkout, program.format(module))[0] == ["3", "0"]
        (checkout / "lidarnaut" / "envs" / f"{module}.py").unlink()


@pytest.mark.skipif(os.name == "nt", reason="home folders are named otherwise")
@pytest.mark.parametrize(
    ("variables", "reason"),
    [
        ({"XDG_CACHE_HOME": "{tmp}/file"}, "Not a directory"),
        ({"XDG_CACHE_HOME": "relative", "HOME": "relative"}, "the home folder is unknown"),
        ({"NUMBA_CACHE_DIR": "{tmp}/open"}, "another user owns it or may write to it"),
    ],
)
def test_a_temporary_folder_of_the_user_replaces_a_cache_folder_that_cannot_be_used(
    checkout, tmp_path, variables, reason
):
    (tmp_path / "file").touch()
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    variables = {name: value.format(tmp=tmp_path) for name, value in variables.items()}
    for compiled, hit in ((1, "0"), (0, "1"))[: 2 if reason == "Not a directory" else 1]:
        result, said = run(checkout, TMPDIR=str(tmp_path), **variables)
        assert result == ["7", "3", hit, hit]
        assert said.count("compiled kernels are kept in") == 1
        assert reason in said
        assert len(said.splitlines()) == 1 + compiled
    folder = tmp_path / f"lidarnaut-{os.geteuid()}"
    assert str(folder) in said
    assert folder.stat().st_mode & 0o022 == 0
    assert sorted(path.name for path in checkout.iterdir()) == ["lidarnaut"]
    assert not any((tmp_path / "open").iterdir())


@pytest.mark.skipif(os.name == "nt", reason="folders have no such modes")
@pytest.mark.parametrize("kind", ["link", "foreign"])
def test_a_temporary_folder_that_is_not_private_is_not_used(checkout, tmp_path, kind):
    other, program = tmp_path / "other", PROGRAM
    other.mkdir(mode=0o700)
    folder = tmp_path / f"lidarnaut-{os.geteuid()}"
    if kind == "link":
        folder.symlink_to(other)
    else:  # the process acts as another user
        folder = tmp_path / "lidarnaut-54321"
        folder.mkdir(mode=0o700)
        program = f"import os\nos.geteuid = lambda: 54321\n{PROGRAM}"
        if os.geteuid() == 0:
            os.chown(folder, 12345, -1)
    result, said = run(checkout, program, TMPDIR=str(tmp_path), XDG_CACHE_HOME="/dev/null")
    assert result == ["7", "3", "0", "0"]
    assert said.count("are not kept") == 1
    assert len(said.splitlines()) == 2
    assert not any(other.iterdir())
    assert not any(folder.iterdir())


class Bomb:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


@pytest.mark.parametrize("damages", [("empty", "pickle"), ("flipped bit", "folder")])
def test_a_damaged_kernel_is_compiled_again(compiled, tmp_path, damages):
    """One message names the first."""
    damaged = []
    for kernel, damage in zip(("shifted", "same"), damages, strict=True):
        (path,) = (tmp_path / "cache").rglob(f"{kernel}-*.nbc")
        damaged.append(str(path))
        data = path.read_bytes()
        flipped = data[:-100] + bytes([data[-100] ^ 1]) + data[-99:]
        bomb = pickle.dumps(Bomb(str(tmp_path / "executed")))
        if damage == "folder":
            path.unlink()
            path.mkdir()
        else:
            path.write_bytes({"empty": b"", "flipped bit": flipped, "pickle": bomb}[damage])
    result, said = run(compiled)
    assert result == ["7", "3", "0", "0"]
    assert not (tmp_path / "executed").exists()
    assert said.count("is compiled again: it is damaged") == said.count("is compiled again") == 1
    assert damaged[0] in said
    assert "folder" in damages or run(compiled) == (["7", "3", "1", "1"], "")


def test_a_kernel_that_cannot_be_written_is_compiled_in_memory(checkout, tmp_path):
    fail = """
import errno, pathlib
def fail(*arguments):
    raise OSError(errno.ENOSPC, "no luck")
pathlib.Path.replace = fail
"""
    result, said = run(checkout, fail + PROGRAM)
    assert result == ["7", "3", "0", "0"]
    assert said.count("is not kept") == said.count(".nbc is not kept") == 1
    assert not list((tmp_path / "cache").rglob("*.nbc*"))


def test_a_cache_folder_may_disappear(compiled, tmp_path):
    delete = f"import shutil\nshutil.rmtree({str(tmp_path / 'cache')!r})\nprint(shifted"
    result, said = run(compiled, PROGRAM.replace("print(shifted", delete))
    assert result == ["7", "3", "0", "0"]
    assert "kept" not in said
    assert run(compiled)[0] == ["7", "3", "1", "1"]


def test_processes_may_compile_the_same_kernels_at_once(checkout):
    """For different types, too: a file holds the code of one signature."""
    processes = [start(checkout, PROGRAM.replace("3", number)) for number in ("3", "3", "3.5")]
    results = [process.communicate()[0].split()[:2] for process in processes]
    assert results == [["7", "3"], ["7", "3"], ["8.0", "3.5"]]
    both = PROGRAM.replace("print(", "shifted(3.5), same(3.5)\nprint(")
    assert run(checkout, both) == (["7", "3", "2", "2"], "")


def test_workers_leave_messages_to_their_parent(checkout):
    (checkout / "work.py").write_text(
        "from lidarnaut.envs.outer import shifted\n\n\ndef work(x):\n    return shifted(x)\n"
    )
    program = (
        "import multiprocessing, work\nif __name__ == '__main__':\n"
        "    with multiprocessing.get_context('spawn').Pool(2) as pool:\n        print(*pool.map(work.work, [3, 4]))"
    )
    result, said = run(checkout, program, TMPDIR=str(checkout.parent), XDG_CACHE_HOME="/dev/null")
    assert result == ["7", "9"]
    assert said.count("are kept in") == 1


@pytest.mark.skipif(os.name == "nt", reason="there are no such terminals")
def test_a_terminal_shows_how_many_kernels_have_been_compiled(checkout):
    ours, theirs = os.openpty()
    pytest.importorskip("termios").tcsetwinsize(theirs, (24, 80))
    assert start(checkout, stderr=theirs).wait() == 0
    shown = os.read(ours, 100_000).decode()
    assert "compiling: 0 kernels [00:0" in shown
    assert shown.rstrip(" ").endswith("\r")


def test_all_kernels_are_kept_so():
    folders = ("agents", "baselines", "benchmarks", "driver", "envs")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    texts = {path: text for path in files if "cache=True" in (text := path.read_text(encoding="utf-8"))}
    assert len(texts) > 50
    assert [path for path, text in texts.items() if OWN not in text or "numba import njit" in text] == []
