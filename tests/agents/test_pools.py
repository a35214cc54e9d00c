import os
import sys
from pathlib import Path

import pytest

from lidarnaut.agents.pools import RayExecutor, collect_files, enter_folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    files = {"room.yaml": "polylines: []", "../maps/m.yaml": "image: m.pgm", "../maps/m.pgm": "P5", "large.bin": "x"}
    files |= {"runs/a/policy.safetensors": "w", "runs/a/checkpoint.json": "{}", "runs/a/replay/1.safetensors": "r"}
    files |= {'a "small"\\ room.yaml': "polylines: []", "path.yaml": "x"}
    files |= {"mine_in_pools.py": "import helper_in_pools", "helper_in_pools.py": ""}
    for name, text in files.items():
        path = tmp_path / "here" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "here")])
    for name in ("mine_in_pools", "helper_in_pools"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path / "here"


NAMED = [{"world": "room.yaml", "map": ("../maps/m.yaml", 3, None)}, "runs/a", "rooms", "mine_in_pools:Mine", ""]
NAMED += [{'a "small"\\ room.yaml': {}}, Path("path.yaml"), "a\0b"]


def test_files_that_texts_name_and_own_modules_are_collected(here):
    import mine_in_pools  # noqa: F401

    names = {"room.yaml", "../maps/m.yaml", "../maps/m.pgm", "runs/a/policy.safetensors", "runs/a/checkpoint.json"}
    names |= {'a "small"\\ room.yaml', "path.yaml"}
    found = dict(collect_files(NAMED))
    assert found.keys() == names | {"mine_in_pools.py", "helper_in_pools.py"}
    assert found["../maps/m.pgm"] == b"P5"


def test_a_worker_enters_the_folder_if_it_holds_the_same_files_and_a_copy_otherwise(here, tmp_path, monkeypatch):
    files = dict(collect_files(NAMED))
    monkeypatch.chdir("/")
    assert enter_folder(str(here), files) is None
    assert Path.cwd() == here
    assert sys.path[-1] == str(here)
    for change in (here / "room.yaml").write_text, lambda _: here.rename(tmp_path / "gone"):
        change("another world")
        os.chdir("/")
        copy = enter_folder(str(here), files)
        assert {name: Path(name).read_bytes() for name in files} == files
        assert Path.cwd() == Path(copy.name + str(here))
        assert sys.path[-1] == str(Path.cwd())
        assert str(here) not in sys.path
        os.chdir("/")
        copy.cleanup()


def test_an_absolute_path_must_hold_the_same_file_on_every_machine(here, monkeypatch):
    path = str(here / "room.yaml")
    files = dict(collect_files([path]))
    assert files == {path: b"polylines: []"}
    Path(path).write_text("another world")
    with pytest.raises(ValueError, match=f"{path} is missing or different; relative paths work on every machine"):
        enter_folder(str(here), files)


def test_a_process_is_not_kept_waiting_by_an_address_without_a_cluster(monkeypatch, tmp_path):
    """Ray is replaced by a module that never answers, and by one that fails with a traceback."""
    monkeypatch.setitem(sys.modules, "ray", object())
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("lidarnaut.agents.pools.CONNECT_LIMIT", 2.0)
    (tmp_path / "ray.py").write_text("import time\ntime.sleep(60)")
    with pytest.raises(ConnectionError, match=r"--ray auto: no cluster answers: none within 2 s"):
        RayExecutor("auto")
    with pytest.raises(ConnectionError, match=r"--ray ray://127\.0\.0\.1:9: no cluster answers: .*refused"):
        RayExecutor("ray://127.0.0.1:9")
    monkeypatch.setattr("lidarnaut.agents.pools.CONNECT_LIMIT", 30.0)
    (tmp_path / "ray.py").write_text("raise ConnectionError('no instance\\nis there')")
    with pytest.raises(ConnectionError, match=r"--ray auto: no cluster answers: no instance is there$"):
        RayExecutor("auto")
