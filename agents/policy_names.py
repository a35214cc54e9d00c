"""Construction of policies from their names on the command line."""

import glob
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

from gymnasium import spaces
from pydantic import ValidationError

from lidarnaut.baselines import ALL
from lidarnaut.baselines.adoption import adopt, needed_arguments
from lidarnaut.baselines.policy import GROUND_TRUTH, Level, ObservationPolicy, Policy, marked
from lidarnaut.envs.files import explain_errors, explain_unknown, load_object, resolve, split_parameters

Makers = Mapping[str, Callable[[], Any]]
"""Constructors of the classic (not learned) policies for a task, by name."""


def is_bound(policy: str) -> bool:
    """Return whether a policy's name has the suffix that marks access to ground truth."""
    return policy.endswith(GROUND_TRUTH)


def short(policy: str) -> str:
    """Return a short name of a policy for legends: `ppo:a/long/path` becomes `ppo path`."""
    kind, _, path = policy.removesuffix(GROUND_TRUTH).partition(":")
    parts = [part for part in path.split("/") if part not in ("", "checkpoints")]
    return f"{kind} {parts[-1]}{GROUND_TRUTH * is_bound(policy)}" if parts and len(path) > 24 else policy


@dataclass(frozen=True, slots=True)
class PolicySource:
    """Picklable description of a policy, to construct it in any process."""

    name: str
    """Name or label given by the user, with a suffix if the policy uses ground truth."""
    source: Any
    """Policy object, class or function, or its import path `module:attribute`. With a checkpoint, its arguments of
    `load_policy`."""
    checkpoint: str = ""
    """Path of the checkpoint folder of a learned policy; empty for other policies."""
    model: str = ""
    """First 12 digits of the SHA-256 hash of the network weights."""
    observes: bool = False
    """Whether the policy takes Gymnasium observations; otherwise, sensor readings and the SLAM estimate."""
    level: Level | None = None
    """Type of action: `twist` (velocity command) or `decision` (choice of a frontier); None if not declared."""
    arguments: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Environment arguments required by the policy, by name."""

    def make(self, space: spaces.Space | None = None) -> Policy:
        source = load_object(self.source) if isinstance(self.source, str) else self.source
        if self.checkpoint:
            from lidarnaut.agents.learned import load_policy

            source = load_policy(Path(self.checkpoint), **self.source)
        return adopt(source, space)


def parse_policy(
    name: str, classic: Makers = ALL, custom: Mapping[str, Any] | None = None, trust: Iterable[str] = ()
) -> PolicySource:
    """Return the description of a policy with a given name, after constructing the policy once as a check.

    A name is a classic policy, also with parameters (`nearest?max_time=8`), `ppo:PATH`, `learned:PATH` or PATH alone
    (trained policy), `pursuit:PATH` (trained frontier score, driven by `pursuit`), or `module:attribute`. `LABEL=`
    may precede all but plain classic names. PATH is a run folder (its best checkpoint; `RUN@last` or `RUN@STEP` for
    another one), a checkpoint folder, or `pretrained/NAME`; a pattern with `*` selects the last match.
    `?deterministic=false` samples actions.

    Raises:
        ValueError: if the policy is unknown or unsuitable for the task; lists the allowed ones.
        lidarnaut.agents.run_folder.CheckpointError: if a checkpoint is missing or damaged.
    """
    if custom and name in custom:
        return _checked(PolicySource(name, custom[name]), custom[name])
    label, what = match.groups() if (match := re.fullmatch(r"([\w.-]+)=(.+)", name)) else (name, name)
    kind, _, rest = what.partition(":")
    base, _, changes = what.partition("?")
    is_folder = base not in classic and (re.search(r"[/\\]", base) is not None or os.path.isdir(base))
    if label != name and (label in ALL or not (rest or changes or is_folder)):
        raise ValueError(
            f"policy {name!r}: labels (LABEL=ppo:PATH) are for ppo:PATH, module:attribute and classic policies with "
            f"parameters only, and must differ from classic policies ({', '.join(classic)})"
        )
    if changes and base in classic:
        make = partial(make_changed, classic[base], split_parameters(what)[1])
        try:
            return _checked(PolicySource(label, make), make)
        except (TypeError, ValueError) as error:
            raise ValueError(f"policy {name!r}: {error}") from error
    if what in classic:
        return _checked(PolicySource(label, classic[what]), classic[what])
    if is_folder or (kind in ("ppo", "learned", "pursuit") and rest):
        from lidarnaut.agents.learned import find_policy, fingerprint

        path, chosen = split_parameters(rest if kind in ("ppo", "learned", "pursuit") else what)
        deterministic = chosen.pop("deterministic", True)
        for unknown in chosen:
            raise ValueError(f"policy {what!r}: unknown parameter {explain_unknown(unknown, ['deterministic'])}")
        if not isinstance(deterministic, bool):
            raise ValueError(f"policy {what!r}: deterministic must be true or false, got {deterministic!r}")
        pattern, at, which = path.rpartition("@") if "@" in path else (path, "", "")
        runs = glob.glob(path) or [f"{run}{at}{which}" for run in glob.glob(pattern)]
        folder = find_policy(max(runs, default=path)).resolve()
        how = {"pursuit": kind == "pursuit", "deterministic": deterministic, "trust": tuple(trust)}
        policy = PolicySource(label, how, str(folder))
        made = policy.make()  # reports a damaged checkpoint
        return replace(_checked(policy, made), model=fingerprint(folder)[:12])
    if (base if changes else what) in ALL:
        raise ValueError(f"policy {what!r} cannot do this task; allowed are {', '.join(classic)}, and your own")
    if not rest:
        resolve(what, {**classic, "ppo:PATH": None, "LABEL=ppo:PATH": None}, "policy")  # raises
    return _checked(PolicySource(label, what), load_object(what))


def make_changed(make: Callable[..., Any], changes: Mapping[str, Any]) -> Any:
    """Return a policy with changed parameters by name; ValueError if one is unknown or not allowed."""
    pending = dict(changes)
    allowed: list[str] = []

    def changed(params: Any) -> Any:
        known = [one.name for one in fields(params)]
        allowed.extend(known)
        taken = {name: pending.pop(name) for name in known if name in pending}
        try:
            return replace(params, **taken)
        except ValidationError as error:
            raise ValueError("; ".join(explain_errors(error, type(params)))) from None

    own = getattr(signature(make).parameters.get("params"), "default", None)
    policy = make(changed(own)) if is_dataclass(own) else make()
    for part in ("params", "planning", "dwb"):
        if is_dataclass(params := getattr(policy, part, None)):
            setattr(policy, part, changed(params))
    if hasattr(policy, "max_time"):
        allowed.append("max_time")
        given = pending.pop("max_time", policy.max_time)
        try:
            policy.max_time = float(given)
        except (TypeError, ValueError):
            policy.max_time = math.nan
        if not policy.max_time > 0:
            raise ValueError(f"max_time must be a positive number, got {given!r}")
    for name in pending:
        raise ValueError(f"unknown parameter {explain_unknown(name, allowed or ['none'])}")
    return policy


def _checked(policy: PolicySource, source: Any) -> PolicySource:
    made = adopt(source)
    name, observes = marked(policy.name, made), isinstance(made, ObservationPolicy)
    return replace(policy, name=name, level=made.level, observes=observes, arguments=needed_arguments(made))
