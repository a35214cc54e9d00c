"""Files with random damage: an error of one line that names the file, or a log that makes sense; nothing else."""

import gzip
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from envs.logs import load_log
from tests.logs.bags import drive, write_bag
from tests.logs.test_logs import ARRAYS, CARMEN, ROBOTLASER

DAMAGE = st.lists(
    st.one_of(
        st.tuples(st.just("cut"), st.floats(0.0, 1.0, exclude_max=True)),
        st.tuples(st.just("flip"), st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 7)),
        st.tuples(st.just("overwrite"), st.floats(0.0, 1.0, exclude_max=True), st.binary(min_size=1, max_size=16)),
        st.tuples(st.just("insert"), st.floats(0.0, 1.0, exclude_max=True), st.binary(min_size=1, max_size=16)),
    ),
    min_size=1,
    max_size=4,
)
"""What happens to a file, where in it (as a share of its length), and with what."""


def damaged(content, damage):
    content = bytearray(content)
    for kind, where, *value in damage:
        at = int(where * len(content))
        if kind == "cut":
            del content[at:]
        elif kind == "flip" and content:
            content[at] ^= 1 << value[0]
        elif kind == "overwrite":
            content[at : at + len(value[0])] = value[0]
        elif kind == "insert":
            content[at:at] = value[0]
    return bytes(content)


def text(path, content):
    path.write_bytes(content)
    return path, path


def archive(path, save):
    save(path, **ARRAYS)
    return path, path


def bag(folder, storage, suffix):
    path = write_bag(folder / "drive", drive, storage)
    return path, next(file for file in [path, *folder.rglob("*")] if file.suffix == suffix)


LOGS = {
    "text": lambda folder: text(folder / "drive.log", CARMEN.encode()),
    "robotlaser": lambda folder: text(folder / "drive.clf", ROBOTLASER.encode()),
    "gzip": lambda folder: text(folder / "drive.log.gz", gzip.compress(CARMEN.encode())),
    "arrays": lambda folder: archive(folder / "drive.npz", np.savez),
    "compressed arrays": lambda folder: archive(folder / "drive.npz", np.savez_compressed),
    "ros1": lambda folder: bag(folder, "ros1", ".bag"),
    "sqlite": lambda folder: bag(folder, "sqlite3", ".db3"),
    "mcap": lambda folder: bag(folder, "mcap", ".mcap"),
    "mcap file": lambda folder: bag(folder, "file", ".mcap"),
    "metadata": lambda folder: bag(folder, "mcap", ".yaml"),
}
"""Functions of a folder that return the path of a log, and the file in it that is damaged."""


def check(path):
    """Read a log as a user does: an error names it in one line, and what is read makes sense."""
    log, said = None, ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            log = load_log(path)
        except (ValueError, OSError) as error:
            said = str(error)
    if log is None:
        assert str(path) in said
        assert "\n" not in said
        return
    assert len(log.ranges) == len(log.scan_rows) > 0
    assert np.isfinite(log.times).all()
    assert np.isfinite(log.odometry).all()
    assert not (log.ranges < 0.0).any()


@pytest.mark.parametrize("kind", LOGS)
def test_a_valid_log_of_each_kind_is_read(kind, tmp_path):
    assert len(load_log(LOGS[kind](tmp_path)[0]).ranges) > 0


@pytest.mark.parametrize("kind", LOGS)
def test_an_empty_file_is_named(kind, tmp_path):
    path, file = LOGS[kind](tmp_path)
    file.write_bytes(b"")
    with pytest.raises(ValueError, match=r"drive") as caught:
        load_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", LOGS)
def test_random_damage_is_named_or_does_no_harm(kind, tmp_path):
    path, file = LOGS[kind](tmp_path)
    content = file.read_bytes()
    health = [HealthCheck.too_slow]

    @settings(max_examples=25, deadline=10_000, derandomize=True, database=None, suppress_health_check=health)
    @given(DAMAGE)
    def load(damage):
        file.write_bytes(damaged(content, damage))
        check(path)

    load()
