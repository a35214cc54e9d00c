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
from numpy.random import Generator
from PIL import Image

from agents.config import TrainingConfig, parse_config
from benchmarks.arena.settings import Settings
from envs.core import LidarEnv
from envs.files import parse_record, read_mapping, read_record
from envs.logs.replay import Options
from envs.logs.replay import main as replay
from envs.robots import load_robot
from envs.tasks.explore import Explore

from . import ROOT
from .bags import write_damaged_bag
from .damage import DEPTH, damage_array, damage_bytes, damage_tree
from .kills import CONFIG

TREE_SHARE, DEEP_SHARE = 0.6, 0.01
"""Shares of the files whose content is damaged, and not their bytes, and of those that nest deeply."""
WORLD = yaml.safe_load("""
source: here
licence: CC0-1.0
height: 0.5
spawns: [[0.5, 0.5, 1.57]]
polylines: [[[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]]
segments: [[4.0, 3.0, 0.0, 3.0], [2.0, 0.0, 2.0, 1.0, 0.2]]
boxes: [[3.0, 2.0, 1.0, 0.4, 0.785]]
polygons: [[[1.0, 2.0], [1.5, 2.0], [1.0, 2.5]]]
cylinders: [[3.0, 1.0, 0.25]]
movers: [{radius: 0.1, speed: 0.5, waypoints: [[0.5, 1.5], [1.5, 1.5]]}]
closures: [[0.0, 3.0, 0.0, 0.0]]
""")
MAP = {"image": "", "resolution": 0.1, "origin": [0.0, 0.0, 0.0], "negate": 0, "occupied_thresh": 0.65}
LOG = "".join(
    f"ODOM {k}.0 0 0.1 0 0 0 {k}.0 nohost {k}.0\nFLASER 4 1.0 2.0 90.0 3.0 {k}.0 0 0 {k}.0 0 0 {k}.5 nohost {k}.5\n"
    for k in range(1, 6)
).encode()
ARRAYS = {"t": np.arange(5.0), "odo": np.zeros((5, 3)), "idx": np.arange(5), "ranges": np.ones((5, 4))}
ARRAYS |= {"ang0": np.float64(-1.0), "dang": np.float64(0.5), "maxr": np.float64(8.0)}


def drive_in(**arguments: Any) -> None:
    """Do what users do with a world or a robot: reset an environment with it and drive for a moment."""
    env = LidarEnv(Explore, physics="kinematic", slam="truth", control_hz=5.0, **arguments)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([1.0, 0.5], dtype=np.float32))
    env.close()


def write_tree(path: Path, tree: Any, rng: Generator) -> Path:
    """Write a damaged tree, or damaged text of it, as YAML; return the path."""
    if rng.random() < DEEP_SHARE:
        key = list(tree)[rng.integers(len(tree))]
        path.write_text(f"{key}: {'[' * DEPTH}{']' * DEPTH}\n")
    elif rng.random() < TREE_SHARE:
        path.write_text(yaml.safe_dump(damage_tree(tree, rng)))
    else:
        path.write_bytes(damage_bytes(yaml.safe_dump(tree).encode(), rng))
    return path


def draw_file(folder: str, rng: Generator) -> dict[str, Any]:
    """Return the content of one of the YAML files in a folder of the checkout."""
    paths = sorted((ROOT / folder).glob("*.yaml"))
    return read_mapping(paths[rng.integers(len(paths))])


def try_map(folder: Path, name: str, rng: Generator) -> None:
    """Damage the YAML or the image of a map of `map_server`."""
    pixels = np.full((20, 30), 254, dtype=np.uint8)
    pixels[5, 5:12] = 0
    suffix = ("pgm", "png")[rng.integers(2)]
    image, content = io.BytesIO(), MAP | {"image": f"{name}.{suffix}", "free_thresh": 0.196}
    Image.fromarray(pixels).save(image, format={"pgm": "PPM", "png": "PNG"}[suffix])
    path = folder / f"{name}.yaml"
    if rng.integers(2):
        (folder / f"{name}.{suffix}").write_bytes(damage_bytes(image.getvalue(), rng))
        path.write_text(yaml.safe_dump(content))
    else:
        (folder / f"{name}.{suffix}").write_bytes(image.getvalue())
        write_tree(path, content, rng)
    drive_in(world=str(path))


def try_world(folder: Path, name: str, rng: Generator) -> None:
    drive_in(world=str(write_tree(folder / f"{name}.yaml", WORLD, rng)))


def try_robot(folder: Path, name: str, rng: Generator) -> None:
    robot = load_robot(write_tree(folder / f"{name}.yaml", draw_file("envs/robots/library", rng) | {"name": name}, rng))
    drive_in(robot=replace(robot, name=name), world="explorebench_loop")


def try_config(folder: Path, name: str, rng: Generator) -> None:
    """Damage the configuration of a training or of an evaluation."""
    tree = draw_file("configs", rng)
    path = write_tree(folder / f"{name}.yaml", tree, rng)
    if "policies" in tree:
        read_record(path, Settings)
    else:
        parse_config(read_mapping(path), name)


def try_log(folder: Path, name: str, rng: Generator) -> None:
    """Damage a log: CARMEN text, also gzipped, or arrays."""
    kind = rng.integers(4)
    path = folder / f"{name}{('.log', '.log.gz', '.npz', '.npz')[kind]}"
    if kind == 0:
        path.write_bytes(damage_bytes(LOG, rng))
    elif kind == 1:
        inside = rng.integers(2)
        packed = gzip.compress(damage_bytes(LOG, rng) if inside else LOG)
        path.write_bytes(packed if inside else damage_bytes(packed, rng))
    else:
        key = list(ARRAYS)[rng.integers(len(ARRAYS))] if kind == 2 else None
        np.savez(path, **{k: damage_array(array, rng) if k == key else array for k, array in ARRAYS.items()})
        if kind == 3:
            path.write_bytes(damage_bytes(path.read_bytes(), rng))
    use_log(path)


def try_bag(folder: Path, name: str, rng: Generator) -> None:
    use_log(write_damaged_bag(folder, name, rng))


def use_log(path: Path) -> None:
    """Do what users do with a log: run a SLAM on it."""
    with contextlib.redirect_stdout(io.StringIO()):
        replay(Options(path, slam="hector", preset="default"))


def try_checkpoint(folder: Path, name: str, rng: Generator) -> None:
    """Damage a checkpoint; in half of the cases its checksums are right all the same."""
    from agents.algorithms import build_policy
    from agents.checkpoint import load_checkpoint

    damaged = Path(shutil.copytree(make_checkpoint(folder), folder / name))
    record = damaged / "checkpoint.json"
    if rng.random() < DEEP_SHARE:
        record.write_text(json.dumps({"format": 1})[:-1] + ', "steps": ' + "[" * DEPTH + "]" * DEPTH + "}")
    elif rng.random() < TREE_SHARE:
        record.write_text(json.dumps(damage_tree(json.loads(record.read_text()), rng)))
    else:
        files = sorted(damaged.iterdir())
        path = files[rng.integers(len(files))]
        path.write_bytes(damage_bytes(path.read_bytes(), rng))
        if path != record and rng.integers(2):
            content = json.loads(record.read_text())
            content["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
            record.write_text(json.dumps(content))
    build_policy(load_checkpoint(damaged), damaged)


def make_checkpoint(folder: Path) -> Path:
    """Return a checkpoint of a small network, saved beside the folder at the first call."""
    valid = folder.parent / "valid"
    if not valid.is_dir():
        from agents.algorithms import build_model
        from agents.checkpoint import save_checkpoint
        from agents.state import capture
        from agents.vec_env import GymnasiumVecEnv, make_vector

        config = parse_record(CONFIG, "small", TrainingConfig)
        env = GymnasiumVecEnv(make_vector(config.environment, "train", config.num_envs))
        saved = save_checkpoint(capture(build_model(config, env), config, [], 10.0), folder.parent / "run", keep=2)
        env.close()
        saved.rename(valid)
    return valid


KINDS: dict[str, Callable[[Path, str, Generator], None]] = {
    "maps": try_map,
    "worlds": try_world,
    "robots": try_robot,
    "configurations": try_config,
    "logs": try_log,
    "checkpoints": try_checkpoint,
    "bags": try_bag,
}
"""Functions of a folder, a name and a generator that write a damaged input of that name and use it."""
