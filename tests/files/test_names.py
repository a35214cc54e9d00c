import pytest

from envs.files import load_object, resolve

TABLE = {"nearest": 1, "tour": 2}


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module of the user's own in the current directory, which is not among the paths of the interpreter."""
    (tmp_path / "mine_of_names.py").write_text("class Outer:\n    inner = 7\n\nspeed = 3\n")
    (tmp_path / "broken_of_names.py").write_text("import no_such_dependency\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in __import__("sys").path if path])


def test_names_objects_and_module_attributes(mine):
    own = object()
    assert resolve("tour", TABLE, "explorer") == 2
    assert resolve(own, TABLE, "explorer") is own
    assert resolve("mine_of_names:speed", TABLE, "explorer") == 3
    assert load_object("mine_of_names:Outer.inner") == 7


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown explorer 'nearst' \(did you mean 'nearest'\?\).*nearest, tour"):
        resolve("nearst", TABLE, "explorer")


@pytest.mark.parametrize("name", ["9" * 5000, "a:" + "?" * 5000])
def test_long_names_make_no_long_messages(name):
    with pytest.raises(ValueError, match=r"(9|\?)\.\.\.(9|\?)") as caught:
        resolve(name, TABLE, "explorer")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere_at_all:x", "no module 'nowhere_at_all'"),
        ("mine_of_names.part:x", r"no module 'mine_of_names\.part'"),
        ("mine_of_names:sped", r"'mine_of_names' has no attribute 'sped' \(did you mean 'speed'\?\).*Outer, speed"),
        ("mine_of_names:Outer.outer", "no attribute 'Outer.outer'"),
        ("mine_of_names:", "module:attribute"),
        ("mine_of_names", "module:attribute"),
    ],
)
def test_what_cannot_be_loaded_is_named(mine, name, message):
    with pytest.raises(ValueError, match=message):
        load_object(name)


def test_what_a_module_imports_is_not_offered(tmp_path, monkeypatch):
    (tmp_path / "imports_of_names.py").write_text(
        "import numpy as np\nfrom dataclasses import dataclass, replace\nfrom envs.simulation import Twist\n"
        "class Mine: pass\ndef drive(): pass\nSPEED = 3\nTWIST = Twist(0, 0)\n"
    )
    (tmp_path / "all_of_names.py").write_text("from envs.simulation import Twist\nSPEED = 3\n__all__ = ['Twist']\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, allowed in (("imports_of_names", "Mine, drive, SPEED, TWIST"), ("all_of_names", "Twist")):
        with pytest.raises(ValueError, match=f"no attribute 'Nope'; allowed are {allowed}$"):
            load_object(f"{name}:Nope")


def test_an_error_inside_the_module_is_not_hidden(mine):
    with pytest.raises(ModuleNotFoundError, match="no_such_dependency"):
        load_object("broken_of_names:x")
