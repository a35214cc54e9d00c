"""Loading of learned policies from folders."""

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

from lidarnaut.agents.frontiers.score import (
    PRETRAINED,
    RECORD_FILE,
    WEIGHTS_FILE,
    FrontierScore,
    PursuitScoreExplorer,
    ScoreExplorer,
)
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint
from lidarnaut.baselines import ALL
from lidarnaut.baselines.policy import Explorer, ObservationPolicy
from lidarnaut.envs.files import printable, read_bytes, read_json

POLICY = "policy"


def find_policy(path: str | Path) -> Path:
    """Return the folder with the weights of a policy; raise CheckpointError if missing.

    `path`: folder of a run (its best checkpoint, or that of an ending `@best`, `@last` or `@STEP`), checkpoint or
    policy, or `pretrained/NAME`. A prefix `ppo:` or `learned:` is ignored.
    """
    path = Path(re.sub("^(ppo|learned):", "", str(path)))
    if path.parts[:1] == ("pretrained",) and not path.exists():
        names = sorted(folder.name for folder in PRETRAINED.glob("*/"))
        if path.name not in names:
            raise CheckpointError(f"unknown policy {path}; available are pretrained/{', pretrained/'.join(names)}")
        path = PRETRAINED / path.name
    name = str(path)
    if name.partition("?")[0] in ALL and not path.exists():
        raise CheckpointError(f"{name} is a classic policy, without a folder: lidarnaut.make_policy({name!r}) makes it")
    for folder in (path, path / POLICY):
        if (folder / RECORD_FILE).exists():
            return folder
    return find_checkpoint(path, "best")


def load_policy(
    policy: str | Path, *, pursuit: bool = False, deterministic: bool = True, trust: Iterable[str] = ()
) -> Explorer | ObservationPolicy:
    """Load a learned policy by its name or folder, see `find_policy`.

    `pursuit`: a score of frontiers only chooses frontiers; drive to them as the explorer `pursuit` does, which chooses
    anew each second. `deterministic`: return the most likely action, instead of sampling.

    Raises:
        CheckpointError: if there is no such policy, it is damaged, or it does not support the options.
        ValueError: if the policy names code that is not trusted.
    """
    folder = find_policy(policy)
    if (folder / RECORD_FILE).exists():
        what = "a completion" if is_completion(folder) else "a frontier score"
        if not deterministic:
            raise CheckpointError(f"{folder} is {what}, always deterministic; leave out deterministic")
        if is_completion(folder):
            from lidarnaut.agents.completion.explorer import ForesightExplorer

            return ForesightExplorer.load(folder)  # drives by pursuit
        return (PursuitScoreExplorer if pursuit else ScoreExplorer)(FrontierScore.load(folder))
    if pursuit:
        raise CheckpointError(f"{folder} is not a frontier score, which pursuit requires; use learned:PATH")
    from lidarnaut.agents.explorer import LearnedPolicy

    return LearnedPolicy.load(folder, deterministic=deterministic, trust=trust)


def is_completion(folder: Path) -> bool:
    """Return whether a policy folder holds a network that completes maps; CheckpointError if it is unreadable."""
    try:
        return read_json(folder / RECORD_FILE).get("kind") == "completion"
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise CheckpointError(f"{folder} holds no readable policy: {printable(error)}") from error


def fingerprint(folder: Path) -> str:
    """Return the SHA-256 checksum (hexadecimal) of a policy's weights."""
    from lidarnaut.agents.checkpoint import POLICY_FILE

    weights = folder / (WEIGHTS_FILE if (folder / RECORD_FILE).exists() else POLICY_FILE)
    return hashlib.sha256(read_bytes(weights)).hexdigest()
