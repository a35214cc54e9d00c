"""Policies by the names that a command line gives them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gymnasium import spaces

from agents.policies import Level, level_of, make_policy, observations_of
from baselines import EXPLORERS
from baselines.explorer import Explorer, ObservationPolicy, Omniscient
from envs.files import load_object, resolve

GROUND_TRUTH = " (ground truth)"
"""How the name of a policy ends that is given ground truth; no other name can end so."""


def is_bound(policy: str) -> bool:
    """Tell by its name whether a policy is given ground truth: it bounds what can be reached, and does not compete."""
    return policy.endswith(GROUND_TRUTH)


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy that can be made in any process."""

    name: str
    """As users write it: a name of the table, `ppo:PATH`, `module:attribute`, or the label that they give to those; it
    ends with `GROUND_TRUTH` where it is `Omniscient`."""
    kind: str
    """A name of the table, `learned`, `pursuit`, or `module:attribute`."""
    checkpoint: str = ""
    """Checkpoint folder of a learned policy, fixed when the name was read: a training may write newer ones."""
    fingerprint: str = ""
    """SHA-256 of its weights."""
    given: Any = None
    """The policy itself, where it was given in Python."""
    level: Level = "twist"
    observations: tuple[str, ...] | None = None
    """Parts of the observation that it needs; None for the environment's own."""

    def make(self, space: spaces.Space | None = None) -> Explorer | ObservationPolicy:
        """Make the policy for an action space."""
        if self.checkpoint:
            from agents.learned import load_policy

            return load_policy(Path(self.checkpoint), pursuit=self.kind == "pursuit")
        return make_policy(resolve(self.kind, EXPLORERS, "policy") if self.given is None else self.given, space)


def parse_policy(name: str, given: Mapping[str, Any] | None = None) -> Policy:
    """Read a name, and make the policy once to see that it can be made.

    Args:
        name: a classic explorer, `ppo:PATH` (`learned:PATH` is the same; of a score of frontiers, `pursuit:PATH` drives
            by pursuit), `module:attribute`, or `LABEL=` before one of the latter. PATH is the folder of a run or a
            checkpoint, or `pretrained/NAME`.
        given: policies by further names.

    Raises:
        ValueError: if there is no such policy; lists those that there are.
        agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
    """
    if given and name in given:
        return _checked(Policy(name, name, given=given[name]), given[name])
    label, what = match.groups() if (match := re.fullmatch(r"([\w.-]+)=(.+)", name)) else (name, name)
    kind, _, rest = what.partition(":")
    if label != name and (label in EXPLORERS or not rest):
        raise ValueError(
            f"policy {name!r}: only ppo:PATH and module:attribute can have names of their own, as LABEL=ppo:PATH, and "
            f"not that of a classic explorer ({', '.join(EXPLORERS)})"
        )
    if kind in ("ppo", "learned", "pursuit") and rest:
        from agents.learned import find_policy, fingerprint

        folder = find_policy(rest).resolve()
        policy = Policy(label, "pursuit" if kind == "pursuit" else "learned", str(folder))
        made = policy.make()  # before the weights are read once more: says what is wrong with a damaged checkpoint
        return replace(_checked(policy, made), fingerprint=fingerprint(folder))
    if what in EXPLORERS:
        return _checked(Policy(label, what), EXPLORERS[what])
    if not rest:
        resolve(what, {**EXPLORERS, "ppo:PATH": None, "LABEL=ppo:PATH": None}, "policy")  # says what is allowed
    return _checked(Policy(label, what), load_object(what))


def _checked(policy: Policy, source: Any) -> Policy:
    """Return a policy with its level and observations, and marked if it is a bound, after making it once."""
    made = make_policy(source)
    said = made if hasattr(made, "level") else source
    name = policy.name + GROUND_TRUTH if isinstance(made, Omniscient) else policy.name
    return replace(policy, name=name, level=level_of(said), observations=observations_of(said))
