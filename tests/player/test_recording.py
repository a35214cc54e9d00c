import io
import zipfile

import numpy as np
import pytest

from envs.player import Recording
from tests.player.episodes import synthetic


def test_a_recording_is_read_as_it_was_written_and_has_the_same_bytes_each_time(tmp_path):
    recording = synthetic(20.0)
    path = tmp_path / "episode.npz"
    path.write_bytes(recording.to_bytes())
    loaded = Recording.load(path)
    assert loaded.about == recording.about | {"format": 2}
    for name, array in recording.arrays.items():
        np.testing.assert_array_equal(getattr(loaded, name), array)
    assert loaded.to_bytes() == recording.to_bytes() == synthetic(20.0).to_bytes()


def rewritten(change):
    with np.load(io.BytesIO(synthetic(5.0).to_bytes())) as archive:
        arrays = {name: archive[name] for name in archive.files}
    change(arrays)
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "No data left in file"),
        (b"<html>", "allow_pickle"),
        (synthetic(5.0).to_bytes()[:-300], "zip"),
        (rewritten(lambda arrays: arrays.pop("scans")), "lacks scans"),
        (rewritten(lambda arrays: arrays.update(time=arrays["time"][:-1])), "not (10"),
        (rewritten(lambda arrays: arrays.update(plan_ends=arrays["plan_ends"] + 1)), "plan_ends do not count plans"),
        (rewritten(lambda arrays: arrays.update(poses=arrays["poses"].astype(float))), "poses is float64"),
        (rewritten(lambda arrays: arrays.update(map_cells=arrays["map_cells"] + 10**6)), "beside the map"),
        (rewritten(lambda arrays: arrays.update(about=np.frombuffer(b'{"format": 7}', np.uint8))), "format 7"),
    ],
)
def test_what_is_no_recording_is_named(tmp_path, content, says):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.npz is no recorded episode") as error:
        Recording.load(path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_what_unpacks_to_too_much_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "episode.npz"
    path.write_bytes(synthetic(5.0).to_bytes())
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    monkeypatch.setattr("envs.files.archives.MAX_BYTES", size)
    Recording.load(path)
    monkeypatch.setattr("envs.files.archives.MAX_BYTES", size - 1)
    with pytest.raises(ValueError, match=rf"npz .*unpacks to {size:,} bytes; at most {size - 1:,} are allowed"):
        Recording.load(path)
