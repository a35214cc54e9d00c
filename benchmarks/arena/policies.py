"""Policies by the names that a command line gives them."""

import glob
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import yaml
from gymnasium import spaces

from lidarnaut.agents.policies import Level, level_of, make_policy, needed_arguments
from lidarnaut.baselines import CLASSIC, EXPLORERS
from lidarnaut.baselines.explorer import GROUND_TRUTH, marked
from lidarnaut.baselines.explorer import Policy as Driver
from lidarnaut.envs.files import explain_unknown, load_object, resolve

Makers = Mapping[str, Callable[[], Any]]
"""The classic policies that can do a task, by name; see `baselines.policies_for`."""


def is_bound(policy: str) -> bool:
    """Tell by its name whether a policy is given ground truth: it bounds what can be reached, and does not compete."""
    return policy.endswith(GROUND_TRUTH)


def short(policy: str) -> str:
    """Return a policy's name for a legend: of `ppo:a/long/path` the kind and the last part."""
    kind, _, path = policy.removesuffix(GROUND_TRUTH).partition(":")
    parts = [part for part in path.split("/") if part not in ("", "checkpoints")]
    return f"{kind} {parts[-1]}{GROUND_TRUTH * is_bound(policy)}" if parts and len(path) > 24 else policy


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy that can be made in any process."""

    name: str
    """As users write it, or the label that they give it; see `lidarnaut.baselines.explorer.marked` for its end."""
    source: Any = None
    """What `lidarnaut.agents.policies.make_policy` makes it from, or its `module:attribute`."""
    checkpoint: str = ""
    """Checkpoint folder of a learned policy, fixed when the name was read: a training may write newer ones."""
    is_pursuit: bool = False
    """Whether a learned score of frontiers drives by pursuit."""
    deterministic: bool = True
    """Whether a learned policy takes its most likely actions, or draws them as in training."""
    trust: tuple[str, ...] = ()
    """Modules and names of code that a learned policy may name; see `lidarnaut.agents.trust`."""
    model: str = ""
    """First 12 digits of the SHA-256 of its weights."""
    observes: bool = False
    """Whether it acts by observations; others get readings and beliefs."""
    level: Level | None = None
    """What it decides; None where it does not say."""
    arguments: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Arguments of the environment that it needs; see `lidarnaut.agents.policies.needed_arguments`."""

    def make(self, space: spaces.Space | None = None) -> Driver:
        """Make the policy for an action space."""
        if self.checkpoint:
            from lidarnaut.agents.learned import load_policy

            how = partial(load_policy, pursuit=self.is_pursuit, deterministic=self.deterministic, trust=self.trust)
            return how(Path(self.checkpoint))
        return make_policy(load_object(self.source) if isinstance(self.source, str) else self.source, space)


def parse_policy(
    name: str, classic: Makers = EXPLORERS, given: Mapping[str, Any] | None = None, trust: Iterable[str] = ()
) -> Policy:
    """Read a name of a policy that the task allows or that is given, and make it once to see that it can be made.

    A name is a classic policy, `ppo:PATH` (`learned:PATH` is the same; of a score of frontiers, `pursuit:PATH` drives
    by pursuit), `module:attribute`, a classic policy with parameters, `nearest?max_time=8,inflation=0.3`, or `LABEL=`
    before one of the latter. PATH is the folder of a run or a checkpoint, or `pretrained/NAME`; of several that a
    pattern with `*` fits, the last by name. After `?deterministic=false` the policy draws its actions as in training.
    A learned policy may name code in `trust`; see `lidarnaut.agents.trust`.

    Raises:
        ValueError: if there is no such policy, or it cannot do the task; lists those that can.
        lidarnaut.agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
    """
    if given and name in given:
        return _checked(Policy(name, given[name]), given[name])
    label, what = match.groups() if (match := re.fullmatch(r"([\w.-]+)=(.+)", name)) else (name, name)
    kind, _, rest = what.partition(":")
    base, _, changes = what.partition("?")
    if label != name and (label in CLASSIC or not (rest or changes)):
        raise ValueError(
            f"policy {name!r}: only ppo:PATH, module:attribute and classic policies with parameters can have names of "
            f"their own, as LABEL=ppo:PATH, and not that of a classic policy ({', '.join(classic)})"
        )
    if changes and base in classic:
        make = partial(make_changed, classic[base], changes)
        try:
            return _checked(Policy(label, make), make)
        except (TypeError, ValueError) as error:
            raise ValueError(f"policy {name!r}: {error}") from error
    if what in classic:
        return _checked(Policy(label, classic[what]), classic[what])
    if kind in ("ppo", "learned", "pursuit") and rest:
        from lidarnaut.agents.learned import find_policy, fingerprint

        path, _, changes = rest.partition("?")
        chosen = {"deterministic": True, **_read_changes(changes)}
        deterministic = chosen.pop("deterministic")
        for unknown in chosen:
            raise ValueError(f"policy {what!r}: unknown parameter {explain_unknown(unknown, ['deterministic'])}")
        if not isinstance(deterministic, bool):
            raise ValueError(f"policy {what!r}: deterministic must be true or false, got {deterministic!r}")
        folder = find_policy(max(glob.glob(path), default=path)).resolve()
        policy = Policy(label, None, str(folder), kind == "pursuit", deterministic, tuple(trust))
        made = policy.make()  # before the weights are read once more: says what is wrong with a damaged checkpoint
        return replace(_checked(policy, made), model=fingerprint(folder)[:12])
    if what in CLASSIC:
        raise ValueError(f"policy {what!r} cannot do this task; allowed are {', '.join(classic)}, and your own")
    if not rest:
        resolve(what, {**classic, "ppo:PATH": None, "LABEL=ppo:PATH": None}, "policy")  # says what is allowed
    return _checked(Policy(label, what), load_object(what))


def _read_changes(changes: str) -> dict[str, Any]:
    """Return the parameters of `max_time=8,inflation=0.3`, values of YAML; none of an empty text."""
    words = (change.partition("=") for change in re.split(r",(?=\w+=)", changes) if change)
    return {name: yaml.safe_load(text) for name, _, text in words}


def make_changed(make: Callable[..., Any], changes: str) -> Any:
    """Make a classic policy with some of its parameters, or of those of its navigator, changed.

    `make` makes the policy, of `params` if it takes them; `changes` are `max_time=8,inflation=0.3`, of YAML values.

    Raises:
        ValueError: if there is no such parameter; lists those there are.
    """
    given = _read_changes(changes)
    allowed: list[str] = []

    def changed(params: Any) -> Any:
        known = {one.name: getattr(params, one.name) for one in fields(params)}
        allowed.extend(known)
        taken = {name: given.pop(name) for name in known.keys() & given.keys()}
        return replace(params, **{k: float(v) if isinstance(known[k], float) else v for k, v in taken.items()})

    own = getattr(signature(make).parameters.get("params"), "default", None)
    policy = make(changed(own)) if is_dataclass(own) else make()
    for part in ("params", "planning"):
        if is_dataclass(params := getattr(policy, part, None)):
            setattr(policy, part, changed(params))
    if hasattr(policy, "max_time"):
        allowed.append("max_time")
        policy.max_time = float(given.pop("max_time", policy.max_time))
    for name in given:
        raise ValueError(f"unknown parameter {explain_unknown(name, allowed or ['none'])}")
    return policy


def _checked(policy: Policy, source: Any) -> Policy:
    """Return a policy with its level and arguments, and marked if it is a bound, after making it once."""
    made = make_policy(source)
    said = made if hasattr(made, "level") else source
    name = policy.name + (marked("", made) or marked("", source))
    level, observes = level_of(said) if hasattr(said, "level") else None, not hasattr(made, "act")
    return replace(policy, name=name, level=level, observes=observes, arguments=needed_arguments(said))
