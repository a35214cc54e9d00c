"""Bags as recorders and converters other than `ros2 bag` write them."""

import shutil
import sqlite3

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores

from lidarnaut.envs.logs import load_log
from tests.logs.bags import SCAN, TF, Messages, write_bag
from tests.logs.mcap_files import MAGIC, channel_of, drive, record, text, write_mcap

SECOND = 10**9


def check(log, times=(101, 102, 103)):
    np.testing.assert_array_equal(log.ranges, [[1.0, 2.0, 3.0]] * len(times))
    np.testing.assert_allclose(log.times, times)
    np.testing.assert_allclose(log.odometry[:, 0], 0.1 * (np.array(times) - 101), atol=1e-9)


@pytest.mark.parametrize(
    "other",
    [
        ("/battery", "json", "Battery", "jsonschema", '{"type": "object"}'),
        ("/battery", "json", "", "", ""),
        ("/lidar", "protobuf", "foxglove.LaserScan", "protobuf", b"\x0a\xb9\x80\xff\x00\x0acore"),
        ("/image", "flatbuffer", "foxglove.Image", "flatbuffer", b"\x80\x00\x00\x00"),
        ("/custom", "cdr", "own_msgs/msg/Custom", "ros2msg", "float32[ this is = no definition"),
        ("/custom", "cdr", "own_msgs/msg/Custom", "ros2msg", "missing_msgs/Part part\n"),
        ("/custom", "cdr", "own_msgs/msg/Custom", "", ""),
        ("/custom", "cdr", "", "", ""),
        ("/custom", "cdr", "own_msgs/msg/Custom", "ros2idl", "module { broken"),
        ("/scan", "json", "sensor_msgs/msg/LaserScan", "jsonschema", "{}"),
        ("/custom", "cdr", "a/msg/B", "ros2msg", "", text("offered_qos_profiles") + text("- {history: [")),
        ("/custom", "cdr", "a/msg/B", "ros2msg", "", b"\xff\xff\xff\xff"),
    ],
)
@pytest.mark.parametrize("compression", [None, "zstd"])
def test_channels_that_are_not_needed_are_not_looked_at(tmp_path, other, compression):
    channels, messages = drive()
    messages = [((topic, "cdr"), *rest) for topic, *rest in messages]
    messages.append(((other[0], other[1]), 102 * SECOND, b'{"volt": 12}'))
    check(load_log(write_mcap(tmp_path / "a.mcap", [*channels, other], messages, compression=compression)))


@pytest.mark.parametrize("schema", ["ros2msg", "ros2idl", ""])
def test_definitions_of_needed_messages_are_not_needed(tmp_path, schema):
    channels, messages = drive()
    channels = [(*channel[:3], schema, "") for channel in channels]
    check(load_log(write_mcap(tmp_path / "a.mcap", channels, messages)))


@pytest.mark.parametrize("profile", ["", "ros1", "ros2", "own"])
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_the_encoding_of_a_channel_counts_not_the_profile(tmp_path, profile, encoding):
    check(load_log(write_mcap(tmp_path / "a.mcap", *drive(encoding), profile=profile)))


def test_transforms_of_ros_1_in_mcap(tmp_path):
    channels, messages = drive("ros1")
    maker = Messages(Stores.ROS1_NOETIC)
    made = maker.transforms(0.0, ("base_link", "laser", 0.3, 0.0, 0.0, 0.0))
    channels.append(channel_of(maker.store, "/tf_static", made.__msgtype__, "ros1", "ros1msg"))
    messages.append(("/tf_static", SECOND, bytes(maker.store.serialize_ros1(made, made.__msgtype__))))
    assert load_log(write_mcap(tmp_path / "a.mcap", channels, messages)).lidar.mount.x == pytest.approx(0.3)


@pytest.mark.parametrize("compression", [None, "", "lz4", "zstd"])
@pytest.mark.parametrize(
    "parts", [{}, {"summary": False}, {"statistics": False}, {"repeats_schemas": False}, {"indexed": False}]
)
def test_indexes_and_compression_are_optional(tmp_path, compression, parts):
    channels, messages = drive()
    check(load_log(write_mcap(tmp_path / "a.mcap", channels, messages, compression=compression, **parts)))


@pytest.mark.parametrize("compression", [None, "", "zstd"])
@pytest.mark.parametrize("indexed", [True, False])
def test_messages_are_read_in_the_order_of_time(tmp_path, compression, indexed):
    channels, messages = drive(times=tuple(range(101, 107)))
    shuffled = [messages[k] for k in np.random.default_rng(0).permutation(len(messages))]
    check(
        load_log(write_mcap(tmp_path / "a.mcap", channels, shuffled, compression=compression, indexed=indexed)),
        range(101, 107),
    )


def test_needed_topics_in_other_encodings_are_named(tmp_path):
    channels, messages = drive()
    as_json = [(topic, "json", kind, "jsonschema", "{}") for topic, _, kind, *_ in channels]
    path = write_mcap(tmp_path / "a.mcap", [as_json[0], channels[1]], messages)
    said = (
        r"a.mcap: only encodings cdr and ros1 can be read, not /scan \(sensor_msgs/msg/LaserScan as json, 3 messages\)"
    )
    with pytest.raises(ValueError, match=said):
        load_log(path)
    path = write_mcap(tmp_path / "b.mcap", [channels[0], as_json[1]], messages)
    with pytest.raises(ValueError, match=r"not /odom \(nav_msgs/msg/Odometry as json, 3 messages\)"):
        load_log(path)
    lidar = ("/lidar", "protobuf", "foxglove.LaserScan", "protobuf", b"\xff")
    beside = [*messages, ("/lidar", 102 * SECOND, b"\x00")]
    path = write_mcap(tmp_path / "c.mcap", [*channels, lidar], beside)
    with pytest.raises(ValueError, match=r"scan_topic /lidar holds no .*Scan; there are /lidar .*Scan as protobuf"):
        load_log(path, scan_topic="/lidar")
    path = write_mcap(tmp_path / "d.mcap", [lidar, ("/x", "cdr", "", "", "")], beside[-1:])
    with pytest.raises(ValueError, match=r"holds no .*Scan; there are /lidar .* as protobuf.*/x \(no schema, 0 mess"):
        load_log(path)


def test_transforms_in_other_encodings_are_counted_in_the_notes(tmp_path):
    channels, messages = drive()
    others = [(topic, "json", kind, "", "") for topic, kind in (("/scan", "sensor_msgs/LaserScan"), ("/tf_static", TF))]
    messages = [((topic, "cdr"), *rest) for topic, *rest in messages]
    messages += [((topic, "json"), SECOND, b"{}") for topic in ("/scan", "/tf_static", "/tf_static")]
    log = load_log(write_mcap(tmp_path / "a.mcap", [*channels, *others], messages))
    listing = f"/scan ({SCAN} as json, 1 messages), /tf_static ({TF} as json, 2 messages)"
    assert log.notes[0] == f"topics in other encodings are left out: {listing}"


def test_messages_say_what_is_wrong_with_a_file(tmp_path):
    channels, messages = drive()
    whole = write_mcap(tmp_path / "a.mcap", channels, messages, compression="zstd").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"cut\.mcap: .*its end is missing"):
        load_log(cut)
    for content in (b"", b"#ROSBAG V2.0\n" * 9, MAGIC):
        cut.write_bytes(content)
        with pytest.raises(ValueError, match=r"cut\.mcap: damaged or not a bag: ."):
            load_log(cut)
    cut.write_bytes(whole.replace(b"zstd", b"zst9"))
    with pytest.raises(ValueError, match=r"cut\.mcap: Unsupported chunk compression 'zst9'"):
        load_log(cut)
    empty = write_mcap(tmp_path / "empty.mcap", channels, [])
    with pytest.raises(ValueError, match=r"holds no .*LaserScan; there are /odom \(.*Odometry, 0 messages\), /scan"):
        load_log(empty)
    wrong = [(topic, time, data[:40]) for topic, time, data in messages]
    with pytest.raises(ValueError, match=r"wrong\.mcap: damaged.*: message 0 of /scan: ."):
        load_log(write_mcap(tmp_path / "wrong.mcap", channels, wrong))


def split(folder, *parts, kind="mcap", **fields):
    """Write a split bag of files, each with channels and messages."""
    folder.mkdir()
    names = [f"part_{k}.mcap" for k in range(len(parts))]
    for name, part in zip(names, parts):
        write_mcap(folder / name, *part, compression="zstd")
    about = {"version": 5, "storage_identifier": kind, "relative_file_paths": names, "compression_mode": "", **fields}
    metadata = {"rosbag2_bagfile_information": about}
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return folder


def test_files_of_a_split_bag_may_overlap_in_time(tmp_path):
    channels, messages = drive(times=tuple(range(101, 121)))
    parts = [messages[k::3] for k in range(3)]
    check(load_log(split(tmp_path / "a", *((channels, part) for part in parts))), range(101, 121))
    late_first = split(tmp_path / "b", (channels, messages[20:]), (channels, messages[:20]))
    check(load_log(late_first), range(101, 121))
    by_topic = [[m for m in messages if m[0] == topic] for topic in ("/scan", "/odom")]
    check(load_log(split(tmp_path / "c", *((channels, part) for part in by_topic))), range(101, 121))


def test_files_of_a_split_bag_may_hold_topics_that_are_not_needed(tmp_path):
    channels, messages = drive()
    battery = ("/battery", "json", "Battery", "jsonschema", "{}")
    topic = {"name": "/battery", "type": "Battery", "serialization_format": "json", "offered_qos_profiles": ""}
    folder = split(
        tmp_path / "a",
        (channels, messages[:3]),
        ([battery, *channels], [("/battery", 102 * SECOND, b"{}"), *messages[3:]]),
        topics_with_message_count=[{"topic_metadata": topic, "message_count": 1}],
    )
    check(load_log(folder))


def test_folders_of_unsupported_kinds_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"a: storage other is not supported, but mcap and sqlite3 are"):
        load_log(split(tmp_path / "a", drive(), kind="other"))
    with pytest.raises(ValueError, match=r"b: compression lz9 is not supported, but zstd is"):
        load_log(split(tmp_path / "b", drive(), compression_mode="FILE", compression_format="lz9"))
    shutil.copytree(split(tmp_path / "c", drive()), tmp_path / "bag.bag")
    check(load_log(tmp_path / "bag.bag"))
    (tmp_path / "c" / "part_0.mcap").unlink()
    with pytest.raises(ValueError, match=r"c: .*part_0\.mcap"):
        load_log(tmp_path / "c")


def test_definitions_that_the_recorder_did_not_find_are_empty_in_sqlite(tmp_path):
    def messages(m):
        for k in range(3):
            yield "/scan", m.scan(101.0 + k, [1.0, 2.0, 3.0])
            yield "/odom", m.odometry(101.0 + k, 0.1 * k, 0.0, 0.0)

    folder = write_bag(tmp_path / "drive", messages, "sqlite3")
    with sqlite3.connect(next(folder.glob("*.db3"))) as base:
        base.execute("UPDATE message_definitions SET encoding = '', encoded_message_definition = ''")
    base.close()
    check(load_log(folder))


def test_records_of_unknown_kinds_are_skipped(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", *drive(), summary=False)
    whole = path.read_bytes()
    header = whole.index(b"ros2") + 8
    path.write_bytes(whole[:header] + record(0x80, rest=b"private") + whole[header:])
    check(load_log(path))
