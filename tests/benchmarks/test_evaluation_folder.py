import json
from pathlib import Path

import pytest

from lidarnaut.benchmarks.arena.evaluation_folder import SETTINGS_FILE, Key, Records
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs import robots
from tests.benchmarks.explorations import COLUMNS

LIBRARY = Path(robots.__file__).parent / "library"
SETTINGS = {"time_limit": 12.5}
LEARNED = 'ppo:a,"odd" path'
MODELS = {"random": "", LEARNED: "f" * 12}


def key(seed, policy="random"):
    return Key(policy, "maze", seed, "tugbot", "kinematic", "truth")


def row(seed, policy="random"):
    values = {name: read("1") for name, read in COLUMNS.items()} | {"duration": 1.0 / 3.0}
    return values | key(seed, policy)._asdict() | {"model": MODELS[policy]}


def records_of(folder, shard="", **worlds):
    return Records(folder, COLUMNS, SETTINGS, shard, worlds)


def test_rows_survive_exactly(tmp_path):
    written = [row(3), row(3, LEARNED)]
    records = records_of(tmp_path)
    for one in written:
        records.add(one)
    again = records_of(tmp_path)
    assert [again.find(key(3, policy), model) for policy, model in MODELS.items()] == written
    assert Key.of(written[0]) == key(3)
    for other in (key(4), key(3)._replace(slam="odometry")):
        assert again.find(other) is None


@pytest.mark.parametrize("kept", ["all but 1 byte", "half a header"])
def test_a_row_that_was_being_written_runs_again(tmp_path, kept):
    records = records_of(tmp_path)
    for seed in (3, 4):
        records.add(row(seed))
    path = tmp_path / "episodes.csv"
    content = path.read_bytes()
    path.write_bytes(content[:-1] if kept == "all but 1 byte" else content[:10])
    again = records_of(tmp_path)
    assert again.find(key(4)) is None
    assert (again.find(key(3)) is None) == (kept == "half a header")
    again.add(row(4))
    assert records_of(tmp_path).find(key(4)) == row(4)


def test_shards_write_files_of_their_own_and_leave_those_of_others_alone(tmp_path):
    first, second = records_of(tmp_path, "1of2"), records_of(tmp_path, "2of2")
    first.add(row(1))
    second.add(row(2))
    with open(tmp_path / "episodes-2of2.csv", "a") as file:
        file.write("random,maze,")
    before = (tmp_path / "episodes-2of2.csv").read_bytes()
    for shard in ("1of2", ""):
        records = records_of(tmp_path, shard)
        assert [records.find(key(seed)) for seed in (1, 2)] == [row(1), row(2)]
    assert (tmp_path / "episodes-2of2.csv").read_bytes() == before
    records_of(tmp_path, "2of2").add(row(3))
    assert records_of(tmp_path).find(key(3)) == row(3)


def test_failures_are_kept_until_the_episode_is_run(tmp_path):
    records = records_of(tmp_path, "1of2")
    records.add_failure(key(3), 'the robot, a "tugbot", fits nowhere')
    again = records_of(tmp_path)
    assert again.failure(key(3)) == 'the robot, a "tugbot", fits nowhere'
    assert again.failure(key(4)) is None
    again.add(row(3))
    assert records_of(tmp_path).failure(key(3)) is None


def test_a_folder_does_not_mix_settings_or_weights_once_an_evaluation_began(tmp_path):
    Records(tmp_path, COLUMNS, {"time_limit": None})
    late, records = Records(tmp_path, COLUMNS, {"time_limit": 5.0}), records_of(tmp_path)
    records.begin()
    with pytest.raises(ValueError, match=r"time_limit 12\.5, not 5\.0"):
        late.begin()
    records_of(tmp_path).begin()
    with pytest.raises(ValueError, match=r"time_limit 12\.5, not None"):
        Records(tmp_path, COLUMNS, {"time_limit": None})
    records.add(row(3, LEARNED))
    with pytest.raises(ValueError, match="other weights"):
        records_of(tmp_path).find(key(3, LEARNED), "0" * 12)
    assert json.loads((tmp_path / SETTINGS_FILE).read_text())["versions"]["numpy"]


def test_damaged_tables_name_the_file_and_the_row(tmp_path):
    records_of(tmp_path).add(row(3))
    path = tmp_path / "episodes.csv"
    header, line = path.read_text().splitlines()
    path.write_text(f"{header}\n{line}\n{line.replace('maze,3', 'maze,three')}\n")
    with pytest.raises(ValueError, match=r"episodes\.csv, row 3: damaged: .*'three'"):
        records_of(tmp_path)
    path.write_text("policy,world,score\nrandom,maze,3\n")
    with pytest.raises(ValueError, match="other columns"):
        records_of(tmp_path)
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(ValueError, match=r"episodes\.csv is no table"):
        records_of(tmp_path)
    for content in (f"{header}\n{'x' * 200_000}\n", f"{header}\n" + "x" * 2**26):
        path.write_text(content)
        with pytest.raises(ValueError, match=r"episodes\.csv( is no table: field larger|: .* bytes; at most)"):
            records_of(tmp_path)
    path.write_bytes(b"")
    for content in ("[1]", "{", "[" * 100_000):
        (tmp_path / SETTINGS_FILE).write_text(content)
        with pytest.raises(ValueError, match=r"settings\.json: .*; choose another --out"):
            records_of(tmp_path)


def test_a_world_of_the_users_own_stays_the_same(tmp_path):
    first, second, folder = tmp_path / "a.yaml", tmp_path / "b.yaml", tmp_path / "out"
    for path, side in ((first, 4), (second, 5)):
        path.write_text(f"bounds: [0, 0, {side}, {side}]\nspawn: [1, 1, 0]\n")

    records_of(folder, maze=str(second)).begin()  # never driven in
    records = records_of(folder, "1of2", maze=str(first))
    records.begin()
    records.add(row(0))
    for other in ("my_package:flat", second):
        with pytest.raises(ValueError, match=rf"{folder} holds .* 'maze' of {first}, not of {other}; give"):
            records_of(folder, maze=str(other))
    first.rename(tmp_path / "moved.yaml")
    records_of(folder, "2of2", maze=str(tmp_path / "moved.yaml")).begin()
    records_of(folder)
    # A map with its image.
    (tmp_path / "a.yaml").write_text("image: a.pgm\nresolution: 0.05\n")
    (tmp_path / "a.pgm").write_bytes(b"one")
    worlds, folder = {"maze": str(tmp_path / "a.yaml")}, tmp_path / "map"
    records_of(folder, **worlds).add(row(0))
    records_of(folder, **worlds)
    (tmp_path / "a.pgm").write_bytes(b"two")
    with pytest.raises(ValueError, match=r"in a world 'maze' of an earlier version of .*a\.yaml; give"):
        records_of(folder, **worlds)


@pytest.mark.parametrize("kind", ["slam", "robots"])
def test_a_changed_file_of_a_slam_preset_or_a_robot_is_noticed(tmp_path, kind):
    own = tmp_path / "own.yaml"
    if kind == "slam":
        first, other, name = "sigma_xy: 0.03\n", "sigma_xy: 0.1\n", f"tinyslam?preset={own}"
    else:
        first, name = (LIBRARY / "raspimouse.yaml").read_text().replace("name: raspimouse", "name: own"), str(own)
        other = first + "# another robot\n"
    own.write_text(first)
    settings = Settings(
        policies=("random",), worlds=("turtlebot3_stage_1",), time_limit=1.0, episodes=1, **{kind: (name,)}
    )
    evaluation = Evaluation(settings, tmp_path / "out")
    assert not evaluation.run()
    Evaluation(settings, tmp_path / "out")
    own.write_text(other)
    with pytest.raises(ValueError, match=r"with '.*own.*' of an earlier version of .*own\.yaml; choose"):
        Evaluation(settings, tmp_path / "out")


@pytest.mark.parametrize("others", [("raspimouse",), ()])
def test_robots_that_differ_and_share_a_name_are_refused(tmp_path, others):
    own = tmp_path / "own.yaml"
    own.write_text((LIBRARY / "raspimouse.yaml").read_text().replace("max_v: 0.26", "max_v: 0.1"))
    (tmp_path / "copy.yaml").write_text((LIBRARY / "raspimouse.yaml").read_text())
    settings = {"policies": ("random",), "worlds": ("turtlebot3_stage_1",), "episodes": 1}
    with pytest.raises(ValueError, match=r"robots 'raspimouse' and '.*own\.yaml' differ, but both"):
        Evaluation(Settings(**settings, robots=(*others, str(own))), tmp_path / "out")
    Evaluation(Settings(**settings, robots=(*others, str(tmp_path / "copy.yaml"))), tmp_path / "out")
