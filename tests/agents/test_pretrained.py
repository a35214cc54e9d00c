import hashlib
import json
import shutil

import pytest

from lidarnaut.agents.frontiers.tasks import HELD_OUT, TRAINING_WORLDS
from lidarnaut.agents.learned import PRETRAINED, load_policy

SHIPPED = sorted(folder for folder in PRETRAINED.iterdir() if folder.is_dir())


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: folder.name)
def test_what_comes_with_the_package_is_whole_and_was_trained_on_the_split(folder):
    files = {path for path in folder.iterdir() if path.name not in ("checksums.sha256", "README.md")}
    sums = {f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in files}
    assert set((folder / "checksums.sha256").read_text().splitlines()) == sums
    assert (folder / "README.md").exists()
    if (folder / "policy.json").exists():
        record = json.loads((folder / "policy.json").read_text())
        assert tuple(record["training_worlds"]) == TRAINING_WORLDS
        assert tuple(record["held_out_worlds"]) == HELD_OUT.worlds
        assert tuple(record["held_out_robots"]) == HELD_OUT.robots
    if (folder / "held_out.yaml").exists():
        now = PRETRAINED.parent / "frontiers" / "held_out.yaml"
        assert (folder / "held_out.yaml").read_bytes() == now.read_bytes()


def test_two_files_of_a_checkpoint_are_a_policy(tiny_run, tmp_path):
    checkpoint = tiny_run / "checkpoints" / "step_000000768"
    for name in ("policy.safetensors", "checkpoint.json"):
        shutil.copy(checkpoint / name, tmp_path)
    shipped, trained = load_policy(tmp_path, trust="tests"), load_policy(checkpoint, trust="tests")
    observation = {name: space.sample() for name, space in shipped._actor.policy.observation_space.items()}
    assert (shipped(observation) == trained(observation)).all()
