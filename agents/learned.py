"""Learned policies by their folders: of a run, of a checkpoint, or one that comes with the package."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from lidarnaut.agents.frontiers.score import (
    RECORD_FILE,
    WEIGHTS_FILE,
    FrontierScore,
    PursuitScoreExplorer,
    ScoreExplorer,
)
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint
from lidarnaut.baselines.explorer import Explorer, ObservationPolicy
from lidarnaut.envs.files import read_bytes

PRETRAINED = Path(__file__).with_name("pretrained")
"""Folder of the policies that come with the package."""
POLICY = "policy"
"""Folder of the policy in a run of evolution."""


def find_policy(path: str | Path) -> Path:
    """Return the folder that holds the weights of a policy: of a run, a checkpoint, a policy, or `pretrained/NAME`.

    Raises:
        CheckpointError: if there is none.
    """
    path = Path(path)
    if path.parts[:1] == ("pretrained",) and not path.exists():
        names = sorted(folder.name for folder in PRETRAINED.glob("*/"))
        if path.name not in names:
            raise CheckpointError(f"there is no policy {path}; there are pretrained/{', pretrained/'.join(names)}")
        path = PRETRAINED / path.name
    for folder in (path, path / POLICY):
        if (folder / RECORD_FILE).exists():
            return folder
    return find_checkpoint(path)


def load_policy(
    folder: Path, *, pursuit: bool = False, deterministic: bool = True, trust: Iterable[str] = ()
) -> Explorer | ObservationPolicy:
    """Load the policy of a folder that `find_policy` returned; a score of frontiers as an explorer.

    That explorer drives by `pursuit` if asked (`lidarnaut.baselines.frontier.pursuit`); others take their most likely
    actions, or draw them as in training if they are not to be `deterministic`. `trust`: modules and names of your own
    code that the policy may name; see `lidarnaut.agents.trust`.

    Raises:
        CheckpointError: if it is damaged, drives by `pursuit` and is no score of frontiers, or draws and is one.
        ValueError: if it names code that is not trusted.
    """
    if (folder / RECORD_FILE).exists():
        if not deterministic:
            raise CheckpointError(
                f"{folder} holds a score of frontiers, which draws no actions; leave out deterministic"
            )
        return (PursuitScoreExplorer if pursuit else ScoreExplorer)(FrontierScore.load(folder))
    if pursuit:
        raise CheckpointError(f"{folder} holds no score of frontiers, which alone drives by pursuit; use learned:PATH")
    from lidarnaut.agents.explorer import LearnedPolicy  # torch takes seconds to load

    return LearnedPolicy.load(folder, deterministic=deterministic, trust=trust)


def fingerprint(folder: Path) -> str:
    """Return the SHA-256 of the weights in a folder that `find_policy` returned."""
    from lidarnaut.agents.checkpoint import POLICY_FILE

    weights = folder / (WEIGHTS_FILE if (folder / RECORD_FILE).exists() else POLICY_FILE)
    return hashlib.sha256(read_bytes(weights)).hexdigest()
