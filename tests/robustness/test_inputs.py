"""Damaged inputs: each is refused by an error that names it, or is used without harm."""

import contextlib
import gzip
import hashlib
import io
import json
import logging
import resource
import shutil
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from lidarnaut.agents.algorithms import build_policy
from lidarnaut.agents.checkpoint import load_checkpoint, save_checkpoint
from lidarnaut.agents.config import TrainingConfig, parse_config
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.state import capture
from lidarnaut.agents.vec_env import GymnasiumVecEnv, make_vector
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import parse_record, read_mapping, read_record
from lidarnaut.envs.logs.replay import Options
from lidarnaut.envs.logs.replay import main as replay
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.explore import Explore
from tests.agents.tiny import untrained
from tests.logs.bags import drive, write_bag
from tests.logs.test_logs import ARRAYS, CARMEN, ROBOTLASER
from tests.robustness.damage import damaged_arrays, damaged_bytes, damaged_messages, damaged_tree
from tests.robustness.test_kills import CONFIG

ROOT = Path(__file__).parents[2]
TIME_LIMIT, MEMORY_LIMIT, LONGEST = 10.0, 16 * 2**30, 5000
"""Processor time of an input [s], address space of the process [bytes], maximum message length [characters]."""
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
people: [{radius: 0.1, speed: 0.5, waypoints: [[0.5, 1.5], [1.5, 1.5]]}]
closures: [[0.0, 3.0, 0.0, 0.0]]
""")
MAP = {"image": "", "resolution": 0.1, "origin": [0.0, 0.0, 0.0], "negate": 0, "occupied_thresh": 0.65}


def drive_in(**arguments):
    env = LidarEnv(Explore, physics="kinematic", slam="truth", control_hz=5.0, **arguments)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([1.0, 0.5], dtype=np.float32))
    env.close()


def use_log(path):
    with contextlib.redirect_stdout(io.StringIO()):
        replay(Options(path, slam="hector", preset="default"))


def use_config(path):
    tree = read_mapping(path)
    read_record(path, Settings) if "policies" in tree else parse_config(tree, path.stem)


def write_yaml(path, tree, draw):
    """Write a damaged tree, or damaged text of it; return the path."""
    if draw(st.integers(0, 2)):
        path.write_text(yaml.safe_dump(draw(damaged_tree(tree))))
    else:
        path.write_bytes(draw(damaged_bytes(yaml.safe_dump(tree).encode())))
    return path


def any_yaml(folder, draw):
    return read_mapping(draw(st.sampled_from(sorted((ROOT / folder).glob("*.yaml")))))


def try_map(folder, draw):
    pixels = np.full((20, 30), 254, dtype=np.uint8)
    pixels[5, 5:12] = 0
    suffix, image = draw(st.sampled_from(["pgm", "png"])), io.BytesIO()
    Image.fromarray(pixels).save(image, format={"pgm": "PPM", "png": "PNG"}[suffix])
    content, path = MAP | {"image": f"input.{suffix}", "free_thresh": 0.196}, folder / "input.yaml"
    is_image = draw(st.booleans())
    (folder / f"input.{suffix}").write_bytes(draw(damaged_bytes(image.getvalue())) if is_image else image.getvalue())
    if is_image:
        path.write_text(yaml.safe_dump(content))
    else:
        write_yaml(path, content, draw)
    drive_in(world=str(path))


def try_world(folder, draw):
    drive_in(world=str(write_yaml(folder / "input.yaml", WORLD, draw)))


def try_robot(folder, draw):
    path = write_yaml(folder / "input.yaml", any_yaml("envs/robots/library", draw) | {"name": "input"}, draw)
    drive_in(robot=replace(load_robot(path), name="input"), world="explorebench_loop")


def try_config(folder, draw):
    use_config(write_yaml(folder / "input.yaml", any_yaml("configs", draw), draw))


def try_log(folder, draw):
    text = draw(st.sampled_from([CARMEN, ROBOTLASER])).encode()
    kind = draw(st.sampled_from(["input.log", "input.log.gz", "input.npz"]))
    path = folder / kind
    if kind == "input.log":
        path.write_bytes(draw(damaged_bytes(text)))
    elif kind == "input.log.gz":
        inside = draw(st.booleans())
        packed = gzip.compress(draw(damaged_bytes(text)) if inside else text)
        path.write_bytes(packed if inside else draw(damaged_bytes(packed)))
    elif draw(st.booleans()):
        np.savez(path, **draw(damaged_arrays(ARRAYS)))
    else:
        np.savez_compressed(path, **ARRAYS)
        path.write_bytes(draw(damaged_bytes(path.read_bytes())))
    use_log(path)


def try_bag(folder, draw):
    storage, in_messages = draw(st.sampled_from(["ros1", "sqlite3", "mcap", "file"])), draw(st.booleans())
    path = write_bag(
        folder / "input", lambda m: draw(damaged_messages(list(drive(m)))) if in_messages else drive(m), storage
    )
    if not in_messages:
        file = draw(st.sampled_from([path] if path.is_file() else sorted(path.iterdir())))
        file.write_bytes(draw(damaged_bytes(file.read_bytes())))
    use_log(path)


def try_checkpoint(folder, draw):
    """Damage a checkpoint; half of them have correct checksums."""
    valid = folder.parents[1] / "valid"
    if not valid.is_dir():
        config = parse_record(CONFIG, "small", TrainingConfig)
        env = GymnasiumVecEnv(make_vector(config.environment, "train", config.num_envs))
        saved = save_checkpoint(capture(untrained(config, env), config, [], 10.0), folder.parents[1] / "run", keep=2)
        env.close()
        saved.rename(valid)
    damaged = Path(shutil.copytree(valid, folder / "input"))
    record = damaged / "checkpoint.json"
    if draw(st.booleans()):
        record.write_text(json.dumps(draw(damaged_tree(json.loads(record.read_text())))))
    else:
        path = draw(st.sampled_from(sorted(damaged.iterdir())))
        path.write_bytes(draw(damaged_bytes(path.read_bytes())))
        if path != record and draw(st.booleans()):
            content = json.loads(record.read_text())
            content["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
            record.write_text(json.dumps(content))
    build_policy(load_checkpoint(damaged, trust="tests"), damaged)


KINDS = {
    "maps": (try_map, 12),
    "worlds": (try_world, 12),
    "robots": (try_robot, 12),
    "configurations": (try_config, 12),
    "logs": (try_log, 30),
    "bags": (try_bag, 30),
    "checkpoints": (try_checkpoint, 6),
}
"""Functions that write and use a file named `input`, and the default number of trials."""


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_inputs_are_refused_by_name_or_do_no_harm(kind, tmp_path, size, row):
    (use, few), outcomes = KINDS[kind], []
    health = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]
    count = size(few, 1500)

    @settings(max_examples=count, deadline=None, derandomize=True, database=None, suppress_health_check=health)
    @given(st.data())
    def attempt(data):
        folder = tmp_path / "tried" / str(len(outcomes))
        folder.mkdir(parents=True)
        began, said = time.process_time(), None
        try:
            use(folder, data.draw)
        except (ValueError, OSError, CheckpointError) as error:
            said = str(error)
            assert "input" in said
            assert len(said) <= LONGEST
        finally:
            shutil.rmtree(folder)
        assert not outcomes or time.process_time() - began < TIME_LIMIT
        outcomes.append(said)

    memory = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, memory[1]))
    logging.disable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            attempt()
    finally:
        logging.disable(logging.NOTSET)
        resource.setrlimit(resource.RLIMIT_AS, memory)
    refused = sum(said is not None for said in outcomes)
    assert refused > 0
    row("damaged inputs", damaged=kind, tried=len(outcomes), refused_by_name=refused, accepted=len(outcomes) - refused)


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".npz", ".bag", ".mcap"])
def test_an_empty_log_is_named(suffix, tmp_path):
    path = tmp_path / f"input{suffix}"
    path.touch()
    with pytest.raises(ValueError, match="input") as caught:
        use_log(path)
    assert "\n" not in str(caught.value)
