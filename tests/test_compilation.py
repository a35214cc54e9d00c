import logging
import subprocess
import sys

import pytest

from envs.compilation import announce_compilation

FIRST_USE = """
import gymnasium, envs
env = gymnasium.make("lidarnaut/ExploreRooms-v0", physics="kinematic", slam="truth")
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module with a kernel of its own, whose cache is empty."""
    (tmp_path / "kernels_of_a_test.py").write_text(
        "from numba import njit\n\n@njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "kernels_of_a_test", raising=False)
    import kernels_of_a_test

    return kernels_of_a_test


def test_what_has_never_been_compiled_is_announced_once(module, caplog):
    with caplog.at_level(logging.WARNING, logger="lidarnaut"):
        announce_compilation(module.double)
        announce_compilation(module.double)
    assert [record.message for record in caplog.records if "compiling" in record.message] == [caplog.records[0].message]


def test_what_has_been_compiled_is_not_announced(module, caplog):
    assert module.double(2) == 4
    with caplog.at_level(logging.WARNING, logger="lidarnaut"):
        announce_compilation(module.double)
    assert not caplog.records


def test_the_first_environment_of_a_machine_says_that_it_compiles(tmp_path):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "PATH": ""}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_USE], env=environment, capture_output=True, text=True, check=True
    )
    assert "compiling the kernels" in done.stderr
