"""Logs as ROS 1 and ROS 2 bags, read without ROS by the library rosbags."""

import itertools
from pathlib import Path

import numpy as np

from lidarnaut.envs.files import MAX_BYTES

from .bag_reader import BagReader, open_bag
from .scans import Recording, Scan
from .trajectory import compose_poses, find_jump_back
from .transforms import MIN_UPRIGHT, FrameTree, frame_name, heading, seconds, yaws

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOM_FRAME = "odom"
"""Frame of odometry by REP 105."""
BASE_FRAMES = ("base_footprint", "base_link")
"""Frames of the base, for odometry that does not say which."""


def is_bag(path: Path) -> bool:
    """Tell whether a path is that of a bag, by its name or by the content of the folder."""
    return path.suffix in (".bag", ".mcap") or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    base_frame: str | None = None,
    odom_frame: str | None = None,
    laser_frame: str | None = None,
) -> Recording:
    """Read the scans and the odometry of a bag.

    Stamps are those of the messages' headers. Without a topic the only one is taken: of LaserScan messages, and of
    Odometry messages or else of transforms from `odom_frame` to the base. Transforms follow the rules of tf2, see
    `FrameTree`: those of the topics `tf` and `tf_static` in the innermost namespace of the scans that has any. The
    lidar's mount is looked up at the time of each scan. By REP 117, ranges above `range_max` of their scan are no
    return, and those below `range_min` or NaN are ignored.

    Raises:
        BagError: the bag is damaged, a topic or frame is missing or ambiguous, or messages make no sense.
    """
    notes: list[str] = []
    with open_bag(path) as bag:
        scan_topic = bag.choose([SCAN], scan_topic, "scan_topic")
        scans, frame = _read_scans(bag, scan_topic, laser_frame)
        tree = _read_transforms(bag, odom_topic if odom_topic in bag.topics(TRANSFORMS) else scan_topic)
        if laser_frame is not None and frame != (wanted := frame_name(laser_frame)):
            if wanted not in tree.frames:
                raise bag.error(f"laser_frame {wanted} is unknown; scans have {frame}, transforms {tree.frames}")
            frame = wanted
        wanted_base = None if base_frame is None else frame_name(base_frame)
        times, poses, base, note = _read_odometry(bag, tree, frame, odom_topic, odom_frame, wanted_base)
        notes += [note] if note else []
        if wanted_base not in (None, base):
            shift = tree.find(base, wanted_base or "", times)
            if shift is not None and np.isfinite(shift).all():
                offset = np.stack([shift[:, 0, 3], shift[:, 1, 3], yaws(shift)], axis=1)
                poses, base = compose_poses(poses, offset), wanted_base or ""
            elif wanted_base in tree.frames:
                base = wanted_base or ""  # the same frame by another name
            else:
                raise bag.error(f"base_frame {wanted_base} is unknown; odometry has {base}, transforms {tree.frames}")
        scan_times = np.array([scan.time for scan in scans])
        mounts = _find_mounts(tree, base, frame, scan_times)
        if mounts is None:
            names = f"no transforms from {base!r} to {frame!r} (--base-frame and --laser-frame choose others)"
            notes.append(f"{names}; the lidar is taken to sit on the base, facing ahead")
            mounts = np.tile(np.eye(4), (len(scans), 1, 1))
        notes += [
            f"{n} transforms of {name!r} are ignored: not finite, or no rotation"
            for name, n in tree.ignored.items()
            if n
        ]
        return Recording(times, poses, _place(bag, scan_topic, scans, mounts, notes), notes, reaches_limit=True)


def _read_scans(bag: BagReader, topic: str, laser_frame: str | None) -> tuple[list[Scan], str]:
    """Return the scans of one frame by time, beams in the frame of the lidar, and the name of the frame."""
    scans: dict[str, list[Scan]] = {}
    size = 0
    for message in bag.messages(topic):
        ranges = np.array(message.ranges, dtype=np.float32)
        ranges[ranges <= 0.0] = np.nan
        size += ranges.nbytes
        if size > MAX_BYTES:
            raise bag.error(f"{topic}: unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
        beams = float(message.angle_min), float(message.angle_increment)
        limits = float(message.range_min), float(message.range_max)
        scan = Scan(ranges, *beams, *limits, time=seconds(message.header.stamp))
        scans.setdefault(frame_name(message.header.frame_id), []).append(scan)
    frame = next(iter(scans)) if laser_frame is None else frame_name(laser_frame)
    if len(scans) > 1 and (laser_frame is None or frame not in scans):
        names = ", ".join(sorted(scans))
        raise bag.error(f"{topic} holds scans of several frames: {names}; choose one by laser_frame (--laser-frame)")
    (frame, found), *_ = [(name, each) for name, each in scans.items() if len(scans) == 1 or name == frame]
    order = _time_order(bag, topic, [scan.time for scan in found])
    return [found[k] for k in order], frame


def _read_transforms(bag: BagReader, scan_topic: str) -> FrameTree:
    """Return the transforms of the innermost namespace of the scans that has any, or of the only one that there is."""
    topics: dict[str, list[str]] = {}
    for topic in bag.topics(TRANSFORMS):
        topics.setdefault(topic.rpartition("/")[0].strip("/"), []).append(topic)
    tree, inner = FrameTree(), f"{scan_topic.strip('/')}/"
    enclosing = [name for name in topics if not name or inner.startswith(f"{name}/")]
    for name in sorted(enclosing or (topics if len(topics) == 1 else ()), key=len)[-1:]:
        for topic in topics[name]:
            for message in bag.messages(topic):
                tree.add(message.transforms, static=topic.endswith("static"))
    return tree


def _read_odometry(
    bag: BagReader, tree: FrameTree, laser: str, topic: str | None, odom_frame: str | None, base: str | None
) -> tuple[np.ndarray, np.ndarray, str, str]:
    """Return times, ascending, shape (n,) [s], poses, shape (n, 3) [m, m, rad], the base's frame, and a note or ""."""
    if topic is None and not bag.topics([ODOMETRY]):
        return *_odometry_of(bag, tree, laser, odom_frame, base), ""
    topic = bag.choose([ODOMETRY] if topic is None else [ODOMETRY, *TRANSFORMS], topic, "odom_topic")
    if bag.types[topic] != ODOMETRY:
        return *_odometry_of(bag, tree, laser, odom_frame, base), ""
    rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for message in bag.messages(topic):
        frames, pose = (frame_name(message.header.frame_id), frame_name(message.child_frame_id)), message.pose.pose
        row = seconds(message.header.stamp), pose.position.x, pose.position.y, heading(pose.orientation)
        rows.setdefault(frames, []).append(row)
    for k, wanted, option in ((0, odom_frame, "odom_frame"), (1, base, "base_frame")):
        if len(names := sorted({frames[k] for frames in rows})) > 1:
            if wanted is None or frame_name(wanted) not in names:
                choice = f"choose one by {option} (--{option.replace('_', '-')})"
                raise bag.error(f"{topic} holds odometry of several frames: {', '.join(names)}; {choice}")
            rows = {frames: each for frames, each in rows.items() if frames[k] == frame_name(wanted)}
    ((_, child), found), *_ = rows.items()
    order = _time_order(bag, topic, [row[0] for row in found])
    table = np.array(found)[order]
    is_valid = np.isfinite(table).all(axis=1)
    if not is_valid.any():
        raise bag.error(f"{topic}: no pose is finite with an orientation")
    number = int((~is_valid).sum())
    note = f"{number} of {len(table)} poses of {topic} are left out: not finite, or no orientation" if number else ""
    return table[is_valid, 0], table[is_valid, 1:], child, note


def _odometry_of(
    bag: BagReader, tree: FrameTree, laser: str, odom_frame: str | None, base: str | None
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return times, poses and the base's frame by transforms; see `_read_odometry`.

    Without a name, the base is the frame right below that of odometry, on the way down to the laser.
    """
    wanted = frame_name(odom_frame or ODOM_FRAME)

    def is_odom(name: str | None) -> bool:
        return name is not None and (name if odom_frame else name.rpartition("/")[2]) == wanted

    chain = tree.above(base or laser)
    children = [low for low, high in itertools.pairwise(chain) if is_odom(high)]
    if not children and base is None:
        children = [name for name in tree.frames if is_odom(tree.parent(name))]
    if len(children) > 1:
        choice = "choose one by base_frame (--base-frame)"
        raise bag.error(f"transforms from {wanted} lead to several frames: {', '.join(children)}; {choice}")
    if not children:
        advice = "odom_frame (--odom-frame) and base_frame (--base-frame) name others"
        to = "" if base is None else f" to {base}"
        raise bag.error(f"holds no transform from {wanted}{to}; frames are {', '.join(tree.frames)}; {advice}")
    times = tree.stamps(children[0])
    poses = tree.find(tree.parent(children[0]) or "", base or children[0], times)
    assert poses is not None
    known = np.isfinite(poses[:, 0, 0])
    if not known.any():
        raise bag.error(f"no transform from {wanted} to {base or children[0]} is valid")
    return (
        times[known],
        np.stack([poses[known, 0, 3], poses[known, 1, 3], yaws(poses[known])], axis=1),
        base or children[0],
    )


def _find_mounts(tree: FrameTree, base: str, frame: str, times: np.ndarray) -> np.ndarray | None:
    """Return the poses of the lidar in the base frame at times, shape (n, 4, 4), NaN where unknown; None for never."""
    found = (tree.find(start, frame, times) for start in ((base,) if base else BASE_FRAMES))
    return next((mounts for mounts in found if mounts is not None), None)


def _place(bag: BagReader, topic: str, scans: list[Scan], mounts: np.ndarray, notes: list[str]) -> list[Scan]:
    """Return scans with beams in the base frame; scans without a level lidar at a known place are left out, and noted.

    A lidar, at `mounts` in the base frame, shape (n, 4, 4), may hang upside down.
    """
    upright = mounts[:, 2, 2]
    unknown, tilted = ~np.isfinite(upright), np.abs(upright) < MIN_UPRIGHT
    tilt = f"the lidar is tilted by {np.degrees(np.arccos(np.abs(upright[tilted]).min(initial=1.0))):.0f} degrees"
    for is_out, why in (
        (unknown, "there is no transform between base and lidar at their time"),
        (tilted, f"{tilt}, scans are no planes of the map"),
    ):
        if is_out.all():
            raise bag.error(f"{topic}: {why}")
        if is_out.any():
            notes.append(f"{is_out.sum()} of {len(scans)} scans are left out: {why}")
    signs, turns = np.sign(upright), yaws(mounts)
    return [
        scan._replace(first=turn + sign * scan.first, step=sign * scan.step, position=tuple(mount[:3, 3].tolist()))
        for scan, mount, sign, turn, out in zip(
            scans, mounts, signs.tolist(), turns.tolist(), (unknown | tilted).tolist(), strict=True
        )
        if not out
    ]


def _time_order(bag: BagReader, topic: str, times: list[float]) -> np.ndarray:
    """Return the order of stamps that ascend but for small jumps; where the clock runs back there is none."""
    jump = find_jump_back(np.array(times))
    if jump is not None:
        clock = f"from {max(times[:jump]):.3f} to {times[jump]:.3f} s"
        raise bag.error(f"{topic}: the clock runs back {clock} at message {jump}")
    if len(times) > 1 and min(times) == max(times):
        raise bag.error(f"{topic}: all messages have the stamp {times[0]:.3f} s")
    return np.argsort(times, kind="stable")
