import contextlib
import multiprocessing
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from lidarnaut.envs.compilation import sources

LAST_PID = re.compile(r"process (\d+) on ")
ROOT = Path(__file__).parents[2]
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


@pytest.mark.skipif(os.name == "nt", reason="home folders are named otherwise")
@pytest.mark.parametrize(
    ("variables", "reason"),
    [
        ({"XDG_CACHE_HOME": "{tmp}/file"}, "Not a directory"),
        ({"NUMBA_CACHE_DIR": "{tmp}/file"}, "File exists"),
        ({"XDG_CACHE_HOME": "", "HOME": "~"}, "the home folder is unknown"),
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
    assert folder.stat().st_mode & 0o777 == 0o700
    assert sorted(path.name for path in checkout.iterdir()) == ["lidarnaut"]
    assert not any((tmp_path / "open").iterdir())


@pytest.mark.skipif(os.name == "nt", reason="folders have no such modes")
@pytest.mark.parametrize("kind", ["open", "link", "foreign"])
def test_a_temporary_folder_that_is_not_private_is_not_used(checkout, tmp_path, kind):
    other, program = tmp_path / "other", PROGRAM
    other.mkdir(mode=0o700)
    folder = tmp_path / f"lidarnaut-{os.geteuid()}"
    if kind == "link":
        folder.symlink_to(other)
    elif kind == "open":
        folder.mkdir(mode=0o755)
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


@pytest.mark.parametrize("damage", ["empty", "half", "flipped bit", "pickle", "folder"])
def test_a_damaged_kernel_is_compiled_again(compiled, tmp_path, damage):
    files = list((tmp_path / "cache").rglob("*.nbc"))
    assert len(files) == 3
    for path in files:
        data = path.read_bytes()
        flipped = data[:-100] + bytes([data[-100] ^ 1]) + data[-99:]
        bomb = pickle.dumps(Bomb(str(tmp_path / "executed")))
        if damage == "folder":
            path.unlink()
            path.mkdir()
        else:
            path.write_bytes({"empty": b"", "half": data[:500], "flipped bit": flipped, "pickle": bomb}[damage])
    result, said = run(compiled)
    assert result == ["7", "3", "0", "0"]
    assert not (tmp_path / "executed").exists()
    assert said.count("is compiled again") == 1
    assert said.count("it is damaged") == (damage != "folder")
    assert any(str(path) in said for path in files)
    assert damage != "half" or run(compiled) == (["7", "3", "1", "1"], "")


@pytest.mark.parametrize(("function", "code"), [("builtins.open", "ENOSPC"), ("os.replace", "EDQUOT")])
def test_a_kernel_that_cannot_be_written_is_compiled_in_memory(checkout, tmp_path, function, code):
    fail = f"""
import builtins, errno, os
whole = {function}
def fail(path, *arguments, **options):
    if ".nbc." in str(path):
        raise OSError(errno.{code}, "no luck")
    return whole(path, *arguments, **options)
{function} = fail
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


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
def test_a_process_that_hangs_with_a_lock_is_named_and_not_waited_for(compiled, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    with contextlib.ExitStack() as stack:
        for path in (tmp_path / "cache").rglob("*.lock"):
            file = stack.enter_context(path.open("r+"))
            assert file.read().startswith(f"process {LAST_PID.search(path.read_text())[1]} on ")
            file.seek(0)
            file.truncate()
            file.write("process 77 on a host")
            file.flush()
            fcntl.flock(file, fcntl.LOCK_EX)
        assert run(compiled) == (["7", "3", "1", "1"], "")  # no wait for cached kernels
        for path in (tmp_path / "cache").rglob("*.nbc"):
            path.unlink()
        limits = "import lidarnaut.envs.compilation as own\nown.NAME_HOLDER_AFTER, own.GIVE_UP_AFTER = 0.1, 0.4\n"
        result, said = run(compiled, limits + PROGRAM)
    assert result == ["7", "3", "0", "0"]
    waits, gives_up = "waiting for the lock", "stays with process 77 on a host"
    assert said.count(waits) == said.count(gives_up) == 1
    assert said.index(waits) < said.index(gives_up)


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_locks_are_not_written_through_links(compiled, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("years of work")
    for path in (tmp_path / "cache").rglob("*.*"):
        if path.suffix in (".lock", ".nbc"):
            path.unlink()
        if path.suffix == ".lock":
            path.symlink_to(precious)
    assert run(compiled)[0] == ["7", "3", "0", "0"]
    assert precious.read_text() == "years of work"


@pytest.mark.parametrize("method", ["fork", "forkserver"])
def test_workers_leave_it_to_their_parent_to_say_where_kernels_are_kept(checkout, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip("there is no such method")
    (checkout / "work.py").write_text(
        "from lidarnaut.envs import compilation\nfrom lidarnaut.envs.outer import shifted\n\n\n"
        "def work(x):\n    return shifted(x)\n"
    )
    program = (
        f"import multiprocessing, work\nwith multiprocessing.get_context({method!r}).Pool(2) as pool:\n"
        "    print(*pool.map(work.work, [3, 4]))"
    )
    with tempfile.TemporaryDirectory() as temporary:  # not pytest's: paths of sockets are short
        result, said = run(checkout, program, TMPDIR=temporary, XDG_CACHE_HOME="/dev/null")
    assert result == ["7", "9"]
    assert said.count("are kept in") == 1


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
def test_of_processes_that_need_a_kernel_at_once_one_compiles_it(checkout):
    processes = [start(checkout) for _ in range(3)]
    printed = [process.communicate()[0].split() for process in processes]
    assert [words[:2] for words in printed] == [["7", "3"]] * 3
    for hits in zip(*(words[2:] for words in printed), strict=True):
        assert sorted(hits) == ["0", "1", "1"]


@pytest.mark.skipif(os.name == "nt", reason="there are no such terminals")
def test_a_terminal_shows_how_many_kernels_have_been_compiled(checkout):
    ours, theirs = os.openpty()
    pytest.importorskip("termios").tcsetwinsize(theirs, (24, 80))
    assert start(checkout, stderr=theirs).wait() == 0
    shown = os.read(ours, 100_000).decode()
    assert "compiling: 0 kernels [00:0" in shown
    assert shown.rstrip(" ").endswith("\r")


def test_user_kernels_are_kept_where_numba_keeps_them_and_announced_by_no_one(checkout):
    (checkout / "mine.py").write_text(FILES["other"])
    result, said = run(
        checkout, "import lidarnaut.envs.compilation, mine; print(mine.same(1), mine.same.stats.cache_path)"
    )
    assert result == ["1", str(checkout / "__pycache__")]
    assert said == ""


def test_all_kernels_are_kept_so():
    """Every file with kernels, or a package above it, imports the module that sets the cache directory."""
    root = ROOT / "lidarnaut"
    wanted = str(root / "envs" / "compilation.py")
    files = [path for folder in ("agents", "baselines", "benchmarks", "envs") for path in (root / folder).rglob("*.py")]
    files = [path for path in files if "cache=True" in path.read_text(encoding="utf-8")]
    assert len(files) > 50
    for path in files:
        packages = [folder / "__init__.py" for folder in path.parents if (folder / "__init__.py").exists()]
        assert any(wanted in sources(str(one)) for one in (path, *packages)), path
