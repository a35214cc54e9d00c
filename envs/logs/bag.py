"""Reading ROS 1 and ROS 2 bags as logs, without a ROS installation."""

from pathlib import Path

import numpy as np

from lidarnaut.envs.files import MAX_BYTES

from .bag_reader import NEEDED, ODOMETRY, SCAN, TRANSFORMS, BagReader, open_bag
from .scans import LogContent, Scan, in_base_frame, scan_of
from .trajectory import compose_poses, describe_jump_back
from .transforms import MIN_LEVEL, MIN_UPRIGHT, FrameTree, frame_name, planar

ODOM_FRAME = "odom"
BASE_FRAMES = ("base_footprint", "base_link")
"""Names tried as base frame if odometry messages have no child frame."""


def is_bag(path: Path) -> bool:
    """Return True if a path is a ROS bag: `.bag` or `.mcap` file, or folder with `metadata.yaml`."""
    return path.suffix in (".bag", ".mcap") or (path / "metadata.yaml").is_file()


def read_bag(
    path: Path,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    base_frame: str | None = None,
    odom_frame: str | None = None,
    laser_frame: str | None = None,
) -> LogContent:
    """Read the scans and odometry of a ROS bag. Times are header stamps.

    Default odometry: the only Odometry topic, or transforms from `odom_frame` to the base. Transforms are read from
    `tf` and `tf_static` in the innermost namespace of the scans. As in REP 117, ranges above `range_max` are no return;
    ranges below `range_min` and NaN are ignored.

    Raises:
        BagError: damaged bag, missing or ambiguous topic or frame, or invalid messages.
    """
    base_frame, odom_frame, laser_frame = (name and frame_name(name) for name in (base_frame, odom_frame, laser_frame))
    notes: list[str] = []
    with open_bag(path) as bag:
        scan_topic = bag.choose([SCAN], scan_topic, "scan_topic")
        scans, frame = _read_scans(bag, scan_topic, laser_frame)
        if odom_topic or bag.topics([ODOMETRY]) or not bag.topics(TRANSFORMS):
            odom_topic = bag.choose([ODOMETRY, *TRANSFORMS] if odom_topic else [ODOMETRY], odom_topic, "odom_topic")
        tree = odometry = FrameTree()
        if foreign := bag.foreign(NEEDED):
            notes.append(f"topics in other encodings are left out: {foreign}")
        is_tf = odom_topic not in bag.topics([ODOMETRY])
        near = odom_topic if is_tf and odom_topic else scan_topic
        tree.read(bag, _transform_topics(bag, near, static=True), static=True)
        moving = [near] if near == odom_topic else _transform_topics(bag, near, static=False)
        if is_tf:
            tree.read(bag, moving)
            moving = []
        else:
            odometry = FrameTree()
            odometry.read(bag, [odom_topic or ""])
        times, poses, base = _read_odometry(bag, odometry, base_frame or laser_frame or frame, odom_frame, is_tf)
        scan_times, start = np.array([scan.time for scan in scans]), base_frame or base
        # Static transforms usually suffice, and /tf is large.
        if (mounts := _find_mounts(tree, start, laser_frame or frame, scan_times)) is None or base_frame:
            tree.read(bag, moving)
            mounts = _find_mounts(tree, start, laser_frame or frame, scan_times)
        _check_frames(bag, {"base_frame": base_frame, "laser_frame": laser_frame}, (base, frame), tree)
        if base_frame and (shift := tree.find(base, base_frame, times)) is not None:
            known = np.isfinite(shift[:, 0, 0])
            times, poses = times[known], compose_poses(poses[known], planar(shift[known]))
        if mounts is None:
            names = f"no transforms from {start!r} to {laser_frame or frame!r} (--base-frame, --laser-frame)"
            notes.append(f"{names}; assuming a lidar at the base origin, facing forward")
            mounts = np.tile(np.eye(4), (len(scans), 1, 1))
        for name, number in sorted((tree.ignored | odometry.ignored).items()):
            notes.append(f"{number} transforms or poses of {name!r} are ignored: not finite, or invalid rotation")
        return LogContent(times, poses, _place(bag, scan_topic, scans, mounts, notes), notes, reaches_limit=True)


def _read_scans(bag: BagReader, topic: str, laser_frame: str | None) -> tuple[list[Scan], str]:
    scans: dict[str, list[Scan]] = {}
    size = 0
    for message in bag.messages(topic):
        scan = scan_of(message)
        scan.ranges[scan.ranges < 0.0] = np.nan
        size += scan.ranges.nbytes
        if size > MAX_BYTES:
            raise bag.error(f"{topic}: unpacks to {size:,} bytes; at most {MAX_BYTES:,} are allowed")
        scans.setdefault(frame_name(message.header.frame_id), []).append(scan)
    frame = laser_frame if laser_frame in scans else next(iter(scans))
    if len(scans) > 1 and frame != laser_frame:
        names = ", ".join(sorted(scans))
        raise bag.error(f"{topic} holds scans of several frames: {names}; choose one by laser_frame (--laser-frame)")
    times = [scan.time for scan in scans[frame]]
    if fault := describe_jump_back(np.array(times), "message"):
        raise bag.error(f"{topic}: {fault}")
    if len(times) > 1 and min(times) == max(times):
        raise bag.error(f"{topic}: all messages have the stamp {times[0]:.3f} s")
    return [scans[frame][k] for k in np.argsort(times, kind="stable")], frame


def _transform_topics(bag: BagReader, topic: str, *, static: bool) -> list[str]:
    name, prefix = "tf_static" if static else "tf", f"{topic.strip('/')}/"
    found: dict[str, list[str]] = {"": []}
    for each in bag.topics(TRANSFORMS):
        space = each.rpartition("/")[0].strip("/")
        if each.endswith("static") == static and (not space or prefix.startswith(f"{space}/")):
            found.setdefault(space, []).append(each)
    inner = found[max((space for space in found if found[space]), key=len, default="")]
    return [each for each in inner if each.rpartition("/")[2] == name] or inner


def _read_odometry(
    bag: BagReader, tree: FrameTree, start: str, odom_frame: str | None, is_tf: bool
) -> tuple[np.ndarray, np.ndarray, str]:
    edges = [(child, parent) for child in tree.frames for parent in tree.parents(child)]
    if odom_frame:
        edges = [edge for edge in edges if edge[1] == odom_frame]
    elif is_tf:
        edges = [edge for edge in edges if edge[1].rpartition("/")[2] == ODOM_FRAME]
    if len({child for child, _ in edges}) > 1:
        edges = [edge for edge in edges if edge[0] in tree.above(start)] or edges
    if len(edges) > 1:
        names = ", ".join(f"{child} in {parent}" for child, parent in edges)
        choice = "choose one by base_frame (--base-frame) and odom_frame (--odom-frame)"
        raise bag.error(f"odometry is of several frames: {names}; {choice}")
    if not edges:
        advice = "set odom_frame (--odom-frame)"
        raise bag.error(f"no odometry from {odom_frame or ODOM_FRAME}; frames are {', '.join(tree.frames)}; {advice}")
    if fault := describe_jump_back(tree.stamps(*edges[0]), "message"):
        raise bag.error(f"odometry of {edges[0][0]}: {fault}")
    times, poses = tree.poses(*edges[0])
    if not len(times):
        raise bag.error(f"odometry of {edges[0][0]}: no valid pose")
    return times, poses, edges[0][0]


def _check_frames(bag: BagReader, named: dict[str, str | None], given: tuple[str, str], tree: FrameTree) -> None:
    """Raise a BagError if a named frame is missing in the tree, and is not that of odometry or of scans."""
    for option, name in named.items():
        if name and name not in (*given, *tree.frames):
            raise bag.error(f"{option} {name} is unknown; scans have {given[1]}, transforms {', '.join(tree.frames)}")


def _find_mounts(tree: FrameTree, base: str, frame: str, times: np.ndarray) -> np.ndarray | None:
    found = (tree.find(start, frame, times) for start in ((base,) if base else BASE_FRAMES))
    return next((mounts for mounts in found if mounts is not None), None)


def _place(bag: BagReader, topic: str, scans: list[Scan], mounts: np.ndarray, notes: list[str]) -> list[Scan]:
    upright = mounts[:, 2, 2]
    unknown, tilted = ~np.isfinite(upright), np.abs(upright) < MIN_UPRIGHT
    tilt = f"the lidar is tilted by {np.degrees(np.arccos(np.abs(upright[tilted]).min(initial=1.0))):.0f} degrees"
    missing = "there is no transform between base and lidar at their time"
    for is_out, why in ((unknown, missing), (tilted, f"{tilt}, so its scans are not horizontal")):
        if is_out.all():
            raise bag.error(f"{topic}: {why}")
        if is_out.any():
            notes.append(f"{is_out.sum()} of {len(scans)} scans are left out: {why}")
    if (leaning := np.abs(upright[~(unknown | tilted)]).min(initial=1.0)) < MIN_LEVEL:
        notes.append(f"the lidar is tilted by up to {np.degrees(np.arccos(leaning)):.0f} degrees and treated as level")
    placed = zip(scans, mounts, (unknown | tilted).tolist(), strict=True)
    return [in_base_frame(scan, mount) for scan, mount, is_out in placed if not is_out]
