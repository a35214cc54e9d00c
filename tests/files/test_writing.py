import errno
import os
import platform
import subprocess
import sys

import pytest

from lidarnaut.envs import files
from lidarnaut.envs.files import (
    Lock,
    LockedError,
    append_file,
    naming,
    own_folder,
    temporary_beside,
    write_file,
)
from lidarnaut.envs.logs.bag_writer import BagWriter

NODE = platform.node()


@pytest.fixture
def dead():
    """Return the ID of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.parametrize("write", ["write_file", "write_folder", "BagWriter"])
def test_the_next_writer_in_a_folder_sweeps_it_but_for_what_others_write(write, tmp_path, dead):
    for gone in (f".old.csv.{NODE}.{dead}.tmp", f".{NODE}.{dead}.tmp.{NODE}.{dead}.tmp"):
        (tmp_path / gone).write_text("half")
    (tmp_path / f".old.mcap.{NODE}.{dead}.tmp" / "inside").mkdir(parents=True)
    # Files of an earlier process with this process ID, of another thread, and of the parent process.
    (earlier := tmp_path / f".earlier.csv.{NODE}.{os.getpid()}.tmp").write_text("half")
    os.utime(earlier, (1e9, 1e9))
    kept = {f".live.csv.{NODE}.{os.getpid()}.tmp", f".live.csv.{NODE}.{os.getppid()}.tmp", ".a.tmp"}
    kept |= {f".a.csv.elsewhere.{dead}.tmp", f"a.{dead}.tmp"}
    for name in kept:
        (tmp_path / name).write_text("half")
    if write == "BagWriter":
        BagWriter(tmp_path / "new.mcap").close()
    else:
        getattr(files, write)(tmp_path / "new.mcap", {"a": "x"} if write == "write_folder" else "x")
    assert {path.name for path in tmp_path.iterdir()} == {"new.mcap", *kept}


def test_a_full_disk_is_named(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match=r"No space left on device: '.*b\.csv'"), naming(tmp_path / "b.csv"):
        full(0)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.csv'") as caught:
        write_file(tmp_path / "a.csv", "x")
    assert caught.value.errno == errno.ENOSPC
    assert list(tmp_path.iterdir()) == []


HOLD = """
import sys, pathlib
from lidarnaut.envs import files
from lidarnaut.envs.files import Lock

lock = Lock(pathlib.Path(sys.argv[1]), shared=sys.argv[2] == "s")
lock.__enter__()
print("held", flush=True)
input()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_lock_is_held_by_one_process_or_shared_and_ends_with_it(tmp_path):
    def hold(shared):
        command = [sys.executable, "-c", HOLD, str(tmp_path), "s" if shared else "x"]
        environment = {**os.environ, "PYTHONPATH": os.getcwd()}
        other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
        assert other.stdout.readline() == "held\n"
        return other

    other = hold(shared=False)
    for shared in (False, True):
        with pytest.raises(LockedError, match=rf"{tmp_path} is in use: process {other.pid} on "):
            Lock(tmp_path, shared=shared).__enter__()
    other.kill()
    other.wait()
    other = hold(shared=True)
    with Lock(tmp_path, shared=True):
        pass
    with pytest.raises(LockedError, match="is in use: another process"):
        Lock(tmp_path).__enter__()
    other.kill()
    other.wait()
    with Lock(tmp_path), pytest.raises(LockedError):
        Lock(tmp_path).__enter__()


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege")
def test_nothing_is_written_through_symbolic_links(tmp_path):
    precious, folder = tmp_path / "precious", tmp_path / "folder"
    precious.mkdir()
    (precious / "a").write_text("years of work")
    folder.mkdir()
    for link in (folder / ".lock", folder / "a.csv", temporary_beside(folder / "b.csv")):
        link.symlink_to(precious / "a")
    for act in (lambda: Lock(folder).__enter__(), lambda: append_file(folder / "a.csv", "x")):
        with pytest.raises(OSError, match="symbolic links"):
            act()
    write_file(folder / "a.csv", "x")
    write_file(folder / "b.csv", "x")
    for name in ("a.csv", "b.csv"):
        assert (folder / name).read_text() == "x"
        assert not (folder / name).is_symlink()
    assert (precious / "a").read_text() == "years of work"


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege")
@pytest.mark.parametrize("where", ["a", "below/a"])
@pytest.mark.parametrize("target", ["precious", "precious/a", "absent"])
def test_a_folder_with_links_is_refused_before_anything_is_written(tmp_path, where, target):
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "a").touch()
    folder = own_folder(tmp_path / "folder")
    link = folder / where
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(tmp_path / target)
    with pytest.raises(ValueError, match=rf"{where} is a symbolic link: writing through links is refused; remove it"):
        own_folder(folder)
    (tmp_path / "named").symlink_to(tmp_path / "precious")
    assert own_folder(tmp_path / "named").is_symlink()
    with pytest.raises(ValueError, match="named is a symbolic link"):
        own_folder(tmp_path, "named")
