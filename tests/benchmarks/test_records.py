import json

import pytest

from benchmarks.arena.policies import Policy
from benchmarks.arena.records import COLUMNS, ROWS_FILE, SETTINGS_FILE, Records

SETTINGS = {"seed": 3, "robot": None, "time_limit": 12.5}
RANDOM = Policy("random", "random")
LEARNED = Policy('ppo:a,"odd" path', "ppo", "/checkpoint", "f" * 64)


def row(policy, seed):
    samples = {str: "x", int: 7, float: 1.0 / 3.0}
    values = {name: samples[read] for name, read in COLUMNS.items()}
    return values | {"policy": policy.name, "world": "maze", "seed": seed, "model": policy.fingerprint[:12]}


def test_rows_survive_exactly(tmp_path):
    written = [row(RANDOM, 3), row(LEARNED, 3)]
    records = Records(tmp_path, SETTINGS)
    for one in written:
        records.add(one)
    again = Records(tmp_path, SETTINGS)
    assert [again.find(policy, "maze", 3) for policy in (RANDOM, LEARNED)] == written
    assert again.find(RANDOM, "maze", 4) is None


@pytest.mark.parametrize("kept", ["all but 1 byte", "half a header"])
def test_a_row_that_was_being_written_runs_again(tmp_path, kept):
    records = Records(tmp_path, SETTINGS)
    for seed in (3, 4):
        records.add(row(RANDOM, seed))
    path = tmp_path / ROWS_FILE
    content = path.read_bytes()
    path.write_bytes(content[:-1] if kept == "all but 1 byte" else content[:10])
    again = Records(tmp_path, SETTINGS)
    assert again.find(RANDOM, "maze", 4) is None
    assert (again.find(RANDOM, "maze", 3) is None) == (kept == "half a header")
    again.add(row(RANDOM, 4))
    assert Records(tmp_path, SETTINGS).find(RANDOM, "maze", 4) == row(RANDOM, 4)


def test_a_folder_does_not_mix_settings_or_weights(tmp_path):
    Records(tmp_path, SETTINGS).add(row(LEARNED, 3))
    with pytest.raises(ValueError, match=r"time_limit 12\.5, not None"):
        Records(tmp_path, SETTINGS | {"time_limit": None})
    with pytest.raises(ValueError, match="other weights"):
        Records(tmp_path, SETTINGS).find(Policy(LEARNED.name, "ppo", "/checkpoint", "0" * 64), "maze", 3)
    assert json.loads((tmp_path / SETTINGS_FILE).read_text())["versions"]["numpy"]


def test_a_table_of_another_version_is_refused(tmp_path):
    (tmp_path / ROWS_FILE).write_text("policy,world,score\nrandom,maze,3\n")
    with pytest.raises(ValueError, match="other columns"):
        Records(tmp_path, SETTINGS)
