import sys

import pytest

from lidarnaut.envs.files import load_object, resolve

TABLE = {"nearest": 1, "tour": 2}


@pytest.fixture(autouse=True)
def mine(tmp_path, monkeypatch):
    """Modules in the current directory, which is not in `sys.path`."""
    for name, text in {
        "mine": "class Outer:\n    inner = 7\n\nspeed = 3\n",
        "broken": "import no_such_dependency\n",
        "importing": "import numpy as np\nfrom dataclasses import dataclass\n"
        "from lidarnaut.envs.simulation import Twist\n"
        "class Mine: pass\ndef drive(): pass\nSPEED = 3\nTWIST = Twist(0, 0)\n",
        "all": "from lidarnaut.envs.simulation import Twist\nSPEED = 3\n__all__ = ['Twist']\n",
    }.items():
        (tmp_path / f"{name}_of_names.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])


def test_names_objects_and_module_attributes():
    own = object()
    assert resolve("tour", TABLE, "explorer") == 2
    assert resolve(own, TABLE, "explorer") is own
    assert resolve("mine_of_names:speed", TABLE, "explorer") == 3
    assert load_object("mine_of_names:Outer.inner") == 7


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nearst", r"unknown explorer 'nearst' \(did you mean 'nearest'\?\).*nearest, tour"),
        ("9" * 5000, r"9\.\.\.9"),
        ("a:" + "?" * 5000, r"\?\.\.\.\?"),
    ],
)
def test_an_unknown_name_lists_the_known_ones_in_a_short_message(name, message):
    with pytest.raises(ValueError, match=message) as caught:
        resolve(name, TABLE, "explorer")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere_at_all:x", "no module 'nowhere_at_all'"),
        ("mine_of_names.part:x", r"no module 'mine_of_names\.part'"),
        ("mine_of_names:sped", r"'mine_of_names' has no attribute 'sped' \(did you mean 'speed'\?\).*Outer, speed"),
        ("mine_of_names:Outer.outer", "no attribute 'Outer.outer'"),
        ("importing_of_names:Nope", "no attribute 'Nope'; allowed are Mine, drive, SPEED, TWIST$"),
        ("all_of_names:Nope", "no attribute 'Nope'; allowed are Twist$"),
        ("mine_of_names:", "module:attribute"),
        ("mine_of_names", "module:attribute"),
    ],
)
def test_what_cannot_be_loaded_is_named(name, message):
    with pytest.raises(ValueError, match=message):
        load_object(name)


def test_an_error_inside_the_module_is_not_hidden():
    with pytest.raises(ModuleNotFoundError, match="no_such_dependency"):
        load_object("broken_of_names:x")
