"""Make the folder of a packaged policy: `python -m lidarnaut.agents.ship RUN agents/pretrained/NAME`.

RUN is a run folder of `train.py`, of evolution or of PPO (its newest checkpoint is taken, without the optimizer). The
new folder holds the policy, `config.yaml`, the learning curve (`curve.png`, and `curve.csv` that it is drawn from),
`held_out.yaml` where the run trained on the worlds that it leaves, and `checksums.sha256` of all of these, as
`sha256sum --check` reads it. The model card, `README.md`, is written by hand; one that is there is kept.
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
LEAVES_THEM = b"lidarnaut.agents.frontiers.tasks:", b"lidarnaut.agents.robots:"
"""What the configuration of a training names that draws its worlds or its robots from what is not held out."""


def main(run: Annotated[Path, tyro.conf.Positional], folder: Annotated[Path, tyro.conf.Positional]) -> None:
    """Write the folder of a policy that comes with the package, in place of an older one but for its model card.

    Args:
        run: run folder.
        folder: to write, `agents/pretrained/NAME`.

    Raises:
        CheckpointError: if the run holds no policy.
        OSError: if its configuration or its learning curve is missing, or the folder cannot be written.
    """
    policy = find_policy(run)
    is_score = policy.name == POLICY
    names = sorted(path.name for path in policy.iterdir()) if is_score else [POLICY_FILE, RECORD_FILE]
    files = {name: (policy / name).read_bytes() for name in names}
    files["config.yaml"] = (run / "config.yaml").read_bytes()
    files["curve.png"] = (run / "learning_curve.png").read_bytes()
    files["curve.csv"] = (run / "evaluations.csv").read_bytes()
    if is_score or any(name in files["config.yaml"] for name in LEAVES_THEM):
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
