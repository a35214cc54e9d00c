"""Packaging of a trained policy: `python -m lidarnaut.agents.package_policy RUN agents/pretrained/NAME`.

RUN is a run folder of evolution or PPO (best checkpoint, or that of `RUN@last` or `RUN@STEP`, without optimizer). The
new folder holds the policy, `config.yaml`, learning curve (`curve.png`, `curve.csv`), `held_out.yaml` if held-out
worlds were excluded, and `checksums.sha256` for `sha256sum --check`. The handwritten model card `README.md` is kept.
"""

import hashlib
from pathlib import Path
from typing import Annotated

import tyro

from lidarnaut.agents.checkpoint import POLICY_FILE
from lidarnaut.agents.learned import POLICY, find_policy
from lidarnaut.agents.run_folder import RECORD_FILE
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.files import write_file

CHECKSUMS, MODEL_CARD = "checksums.sha256", "README.md"
HELD_OUT = Path(__file__).with_name("frontiers") / "held_out.yaml"
SPLIT_MODULES = b"lidarnaut.agents.frontiers.tasks:", b"lidarnaut.agents.robots:"


def main(run: Annotated[Path, tyro.conf.Positional], folder: Annotated[Path, tyro.conf.Positional]) -> None:
    """Copy a trained policy to a folder of the package; keep an existing model card (`README.md`).

    Args:
        run: run folder of the training.
        folder: output folder, `agents/pretrained/NAME`.

    Raises:
        CheckpointError: if the run holds no policy.
        OSError: if files of the run are missing, or writing fails.
    """
    policy = find_policy(run)
    is_score = policy.name == POLICY
    names = sorted(path.name for path in policy.iterdir()) if is_score else [POLICY_FILE, RECORD_FILE]
    files = {name: (policy / name).read_bytes() for name in names}
    run = run if is_score else policy.parent.parent
    files["config.yaml"] = (run / "config.yaml").read_bytes()
    files["curve.png"] = (run / "learning_curve.png").read_bytes()
    files["curve.csv"] = (run / "evaluations.csv").read_bytes()
    if is_score or any(name in files["config.yaml"] for name in SPLIT_MODULES):
        files["held_out.yaml"] = HELD_OUT.read_bytes()
    sums = [f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in files.items()]
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.name != MODEL_CARD:
            path.unlink()
    for name, content in {**files, CHECKSUMS: "".join(sums).encode()}.items():
        write_file(folder / name, content)


if __name__ == "__main__":
    run_command(main)
