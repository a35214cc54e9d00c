"""Explorers by the names that a command line gives them."""

import hashlib
import re
from dataclasses import dataclass, replace
from pathlib import Path

from baselines import EXPLORERS, make_explorer
from baselines.explorer import Explorer, ObservationPolicy


@dataclass(frozen=True, slots=True)
class Policy:
    """An explorer that can be made in any process."""

    name: str
    """As users write it: a classic explorer, or `ppo:PATH`, or the label that they give to that."""
    kind: str
    """A classic explorer, or `ppo`."""
    checkpoint: str = ""
    """Checkpoint folder of a learned explorer, fixed when the name was read: a training may write newer ones."""
    fingerprint: str = ""
    """SHA-256 of its weights."""

    def make(self) -> Explorer | ObservationPolicy:
        """Make the explorer."""
        if not self.checkpoint:
            return make_explorer(self.kind)
        from agents.explorer import PPOExplorer

        return PPOExplorer.load(self.checkpoint)


def parse_policy(name: str) -> Policy:
    """Read a name, and make the explorer once to see that it can be made.

    Raises:
        ValueError: if there is no such explorer; lists those that there are.
        agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
    """
    label, what = match.groups() if (match := re.fullmatch(r"([\w.-]+)=(.+)", name)) else (name, name)
    kind, _, path = what.partition(":")
    if label != name and (label in EXPLORERS or kind != "ppo"):
        raise ValueError(
            f"policy {name!r}: only a learned policy can have a name of its own, as LABEL=ppo:PATH, and not that of a "
            f"classic explorer ({', '.join(EXPLORERS)})"
        )
    if kind == "ppo" and path:
        from agents.checkpoint import POLICY_FILE
        from agents.run_folder import find_checkpoint

        folder = find_checkpoint(Path(path)).resolve()
        policy = Policy(label, kind, str(folder))
        policy.make()  # before the weights are read once more: says what is wrong with a damaged checkpoint
        return replace(policy, fingerprint=hashlib.sha256((folder / POLICY_FILE).read_bytes()).hexdigest())
    if what not in EXPLORERS:
        raise ValueError(
            f"unknown policy {name!r}; allowed are {', '.join(EXPLORERS)}, ppo:PATH of a run folder, and LABEL=ppo:PATH"
        )
    return Policy(label, what)
