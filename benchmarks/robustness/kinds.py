"""Kinds of inputs: a valid one of each, damaged at random, and what a user does with it."""

import contextlib
import gzip
import hashlib
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

from agents.config import TrainingConfig, parse_config
from benchmarks.arena.settings import Settings
from envs.core import LidarEnv
from envs.files import read_mapping, read_record
from envs.logs.replay import Options
from envs.logs.replay import main as replay
from envs.robots import load_robot
from envs.tasks.explore import Explore

from .bags import write_damaged_bag
from .mutations import DEPTH, damage_array, damage_bytes, damage_tree

TREE_SHARE = 0.6
"""Share of the files whose content is damaged, and not their bytes."""
DEEP_SHARE = 0.01
"""Share of the files that nest deeply."""
ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""

WORLD = {
    "source": "here",
    "licence": "CC0-1.0",
    "height": 0.5,
    "spawns": [[0.5, 0.5, 1.57]],
    "polylines": [[[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]],
    "segments": [[4.0, 3.0, 0.0, 3.0], [2.0, 0.0, 2.0, 1.0, 0.2]],
    "boxes": [[3.0, 2.0, 1.0, 0.4, 0.785]],
    "polygons": [[[1.0, 2.0], [1.5, 2.0], [1.0, 2.5]]],
    "cylinders": [[3.0, 1.0, 0.25]],
    "movers": [{"radius": 0.1, "speed": 0.5, "waypoints": [[0.5, 1.5], [1.5, 1.5]]}],
    "closures": [[0.0, 3.0, 0.0, 0.0]],
}
MAP = {"image": "", "resolution": 0.1, "origin": [0.0, 0.0, 0.0], "negate": 0, "occupied_thresh": 0.65}
LOG = "".join(
    f"ODOM {k}.0 0 0.1 0 0 0 {k}.0 nohost {k}.0\nFLASER 4 1.0 2.0 90.0 3.0 {k}.0 0 0 {k}.0 0 0 {k}.5 nohost {k}.5\n"
    for k in range(1, 6)
)
ARRAYS = {
    "t": np.arange(5.0),
    "odo": np.zeros((5, 3)),
    "idx": np.arange(5),
    "ranges": np.ones((5, 4)),
    "ang0": -1.0,
    "dang": 0.5,
    "maxr": 8.0,
}


def drive_in(**arguments: Any) -> None:
    """Do what users do with a world or a robot: reset an environment with it and drive for a moment."""
    env = LidarEnv(Explore, physics="kinematic", slam="truth", control_hz=5.0, **arguments)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([1.0, 0.5], dtype=np.float32))
    env.close()


def write_tree(path: Path, tree: Any, rng: np.random.Generator) -> None:
    """Write a damaged tree, or damaged text of it, as YAML."""
    if rng.random() < DEEP_SHARE:
        key = list(tree)[rng.integers(len(tree))]
        path.write_text(f"{key}: {'[' * DEPTH}{']' * DEPTH}\n")
    elif rng.random() < TREE_SHARE:
        path.write_text(yaml.safe_dump(damage_tree(tree, rng)))
    else:
        path.write_bytes(damage_bytes(yaml.safe_dump(tree).encode(), rng))


def try_map(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage the YAML or the image of a map of `map_server`."""
    pixels = np.full((20, 30), 254, dtype=np.uint8)
    pixels[5, 5:12] = 0
    suffix = ("pgm", "png")[rng.integers(2)]
    image, content = io.BytesIO(), MAP | {"image": f"{name}.{suffix}", "free_thresh": 0.196}
    Image.fromarray(pixels).save(image, format={"pgm": "PPM", "png": "PNG"}[suffix])
    is_image_damaged = bool(rng.integers(2))
    data = damage_bytes(image.getvalue(), rng) if is_image_damaged else image.getvalue()
    (folder / f"{name}.{suffix}").write_bytes(data)
    if is_image_damaged:
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    else:
        write_tree(folder / f"{name}.yaml", content, rng)
    drive_in(world=str(folder / f"{name}.yaml"))


def try_world(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage a world file."""
    write_tree(folder / f"{name}.yaml", WORLD, rng)
    drive_in(world=str(folder / f"{name}.yaml"))


def try_robot(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage the file of a robot."""
    robots = sorted((ROOT / "envs/robots/library").glob("*.yaml"))
    tree = read_mapping(robots[rng.integers(len(robots))])
    write_tree(folder / f"{name}.yaml", tree | {"name": name}, rng)
    robot = replace(load_robot(folder / f"{name}.yaml"), name=name)
    drive_in(robot=robot, world="explorebench_loop")


def try_config(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage the configuration of a training or of an evaluation."""
    path = sorted((ROOT / "configs").glob("*.yaml"))
    source = path[rng.integers(len(path))]
    tree = read_mapping(source)
    write_tree(folder / f"{name}.yaml", tree, rng)
    if "policies" in tree:
        read_record(folder / f"{name}.yaml", Settings)
    else:
        parse_config(read_mapping(folder / f"{name}.yaml"), name)


def try_log(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage a log: CARMEN text, also gzipped, or arrays."""
    kind = rng.integers(4)
    if kind == 0:
        path = folder / f"{name}.log"
        path.write_bytes(damage_bytes(LOG.encode(), rng))
    elif kind == 1:
        path = folder / f"{name}.log.gz"
        inside = rng.integers(2)
        packed = gzip.compress(damage_bytes(LOG.encode(), rng) if inside else LOG.encode())
        path.write_bytes(packed if inside else damage_bytes(packed, rng))
    else:
        path = folder / f"{name}.npz"
        arrays = dict(ARRAYS)
        if kind == 2:
            key = list(arrays)[rng.integers(len(arrays))]
            arrays[key] = damage_array(np.asarray(arrays[key]), rng)
        np.savez(path, **arrays)
        if kind == 3:
            path.write_bytes(damage_bytes(path.read_bytes(), rng))
    use_log(path)


def try_bag(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage a bag of ROS 1 or ROS 2."""
    use_log(write_damaged_bag(folder, name, rng))


def use_log(path: Path) -> None:
    """Do what users do with a log: run a SLAM on it."""
    with contextlib.redirect_stdout(io.StringIO()):
        replay(Options(path, slam="hector", preset="default"))


def try_checkpoint(folder: Path, name: str, rng: np.random.Generator) -> None:
    """Damage a checkpoint; in half of the cases its checksums are right all the same."""
    from agents.algorithms import build_policy
    from agents.checkpoint import load_checkpoint

    valid = make_checkpoint(folder)
    damaged = folder / f"{name}"
    shutil.copytree(valid, damaged)
    record = damaged / "checkpoint.json"
    if rng.random() < DEEP_SHARE:
        record.write_text(json.dumps({"format": 1})[:-1] + ', "steps": ' + "[" * DEPTH + "]" * DEPTH + "}")
    elif rng.random() < TREE_SHARE:
        tree = damage_tree(json.loads(record.read_text()), rng)
        record.write_text(json.dumps(tree))
    else:
        files = sorted(path for path in damaged.iterdir())
        path = files[rng.integers(len(files))]
        path.write_bytes(damage_bytes(path.read_bytes(), rng))
        if path != record and rng.integers(2):
            content = json.loads(record.read_text())
            content["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
            record.write_text(json.dumps(content))
    checkpoint = load_checkpoint(damaged)
    build_policy(checkpoint, damaged)


def make_checkpoint(folder: Path) -> Path:
    """Return a checkpoint of a small network, saved in the folder at the first call."""
    valid = folder.parent / "valid"
    if not valid.is_dir():
        from agents.algorithms import build_model
        from agents.checkpoint import save_checkpoint
        from agents.state import capture
        from agents.vec_env import GymnasiumVecEnv, make_vector
        from envs.files import parse_record

        small = {
            "experiment": "small",
            "total_steps": 64,
            "num_envs": 2,
            "algorithm": "PPO",
            "environment": {"world": "rooms", "world_size": [6.0, 6.0], "num_workers": 0, "time_limit": 10.0},
            "hyperparameters": {"n_steps": 16, "batch_size": 32},
            "network": {"features": 8, "channels": 2, "hidden": 8},
            "checkpoints": {"every": 32, "keep": 2},
        }
        config = parse_record(small, "small", TrainingConfig)
        env = GymnasiumVecEnv(make_vector(config.environment, "train", config.num_envs))
        saved = save_checkpoint(capture(build_model(config, env), config, [], 10.0), folder.parent / "run", keep=2)
        env.close()
        saved.rename(valid)
    return valid


KINDS: dict[str, Callable[[Path, str, np.random.Generator], None]] = {
    "maps": try_map,
    "worlds": try_world,
    "robots": try_robot,
    "configurations": try_config,
    "logs": try_log,
    "checkpoints": try_checkpoint,
    "bags": try_bag,
}
"""Functions of a folder, a name and a generator that write a damaged input of that name and use it."""
