import os
import sys
import zipfile

import numpy as np
import pytest

from lidarnaut.agents.checkpoint import CheckpointError, load_checkpoint
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.benchmarks.arena.trace import Trace
from lidarnaut.envs.files import Lock, archives, open_archive, printable, read_bytes, read_json, write_file
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.bag_writer import BagWriter
from lidarnaut.envs.logs.relations import load_labelled
from lidarnaut.envs.player.recording import Recording


def bomb(path, claimed, size):
    """Write an archive with headers that claim a number of bytes, and `size` zeros."""
    shape = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({claimed},), }}".encode()
    header = (b"\x93NUMPY\x01\x00v\x00" + shape).ljust(127) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("about", "curve", "t", "odo", "idx", "ranges", "origin", "map"):
            file.writestr(f"{name}.npy", header + bytes(size))


READERS = {
    r" is not a trace of an episode \(": Trace.load,
    r" is not a recorded episode \(": Recording.load,
    ": ": load_log,
}


@pytest.mark.parametrize(("what", "load"), READERS.items(), ids=READERS)
def test_an_archive_that_unpacks_to_too_much_is_named(tmp_path, monkeypatch, what, load):
    bomb(tmp_path / "a.npz", 1024, 1024)
    size = 8 * (128 + 1024)
    for limit, says in ((size, ""), (size - 1, f"unpacks to {size:,} bytes; at most {size - 1:,} are allowed")):
        monkeypatch.setattr(archives, "MAX_BYTES", limit)
        with pytest.raises(ValueError, match=rf"a\.npz{what}{says}") as caught:
            load(tmp_path / "a.npz")
        assert ("bytes" in str(caught.value)) == (limit < size)


@pytest.mark.parametrize("make", ["cut", "text", "empty", "lie", "pickle", "npy", "other arrays"])
@pytest.mark.parametrize(("what", "load"), READERS.items(), ids=READERS)
def test_a_damaged_archive_is_named(tmp_path, what, load, make):
    path = tmp_path / "a.npz"
    np.savez(path, about=np.zeros(50), **({"x": np.array([{}])} if make == "pickle" else {}))
    content = path.read_bytes()
    path.write_bytes({"cut": content[:-30], "text": b"text", "empty": b""}.get(make, content))
    if make == "lie":
        bomb(path, 10**15, 0)
    if make == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    with pytest.raises(ValueError, match=rf"a\.npz{what}"):
        load(path)


def test_paths_may_be_text(tmp_path):
    np.savez(tmp_path / "a.npz", b=np.arange(3))
    with open_archive(str(tmp_path / "a.npz")) as archive:
        assert archive["b"].tolist() == [0, 1, 2]
    write_file(str(tmp_path / "a.json"), '{"b": 1}')
    assert read_json(str(tmp_path / "a.json")) == {"b": 1}
    for load in (Recording.load, Trace.load, load_log, load_labelled, load_checkpoint, read_evaluations):
        with pytest.raises((OSError, ValueError, CheckpointError), match="nowhere"):
            load(str(tmp_path / "nowhere.npz"))
    with pytest.raises(ValueError, match=r"as \.mcap"):
        BagWriter(str(tmp_path / "a.bag"))


def test_files_are_read_up_to_a_size(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[" * 200_000)
    with pytest.raises(ValueError, match=r"a\.json: 200,000 bytes; at most 100 are allowed"):
        read_bytes(path, 100)
    for text in ("[" * 200_000, "{", "\xff", "[]", "3", '{"a": Infinity', '{"a": ' + "9" * 5000 + "}"):
        path.write_text(text, encoding="latin-1")
        with pytest.raises(ValueError, match=r"a\.json: (not readable as JSON|must be a mapping of keys to values)"):
            read_json(path)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such files")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a")
    with pytest.raises(ValueError, match="a: is not a regular file"):
        read_bytes(tmp_path / "a")
    for load, name in ((Recording.load, "a.npz"), (load_log, "b.npz"), (load_log, "a.bag"), (load_log, "a.mcap")):
        os.mkfifo(tmp_path / name)
        with pytest.raises(ValueError, match=f"{name}: is not a regular file"):
            load(tmp_path / name)
    os.mkfifo(tmp_path / ".lock")
    with pytest.raises(ValueError, match=r"\.lock: is not a regular file"), Lock(tmp_path):
        pass


def test_the_files_of_a_bag_folder_are_checked(tmp_path):
    (tmp_path / "metadata.yaml").write_text("a: " + "[" * 1000)
    with pytest.raises(ValueError, match=r"metadata\.yaml: .*nested deeper than"):
        load_log(tmp_path)
    (tmp_path / "metadata.yaml").write_text("a: 1")
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match=r"zero\.mcap: is not a regular file"):
        load_log(tmp_path)


@pytest.mark.parametrize(
    ("text", "shown"),
    [("\x1b[2J", "\\x1b[2J"), ("\x9b31m", "\\x9b31m"), ("\u202egnp", "\\u202egnp"), ("a\r\b", "a\\r\\x08"),
     ("\x00\x7f", "\\x00\\x7f"), ("\ud800", "\\ud800"), ("Sân nhỏ\n\t6 m² é", "Sân nhỏ\n\t6 m² é")],
)  # fmt: skip
def test_control_characters_are_shown_and_not_obeyed(text, shown):
    assert printable(text) == shown
