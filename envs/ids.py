"""Lookup of registered environments and of their arguments."""

import importlib
import inspect
import os
import sys
from functools import cache
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator

from lidarnaut.envs.files import explain_unknown, resolve

EXPLORE, CHOOSE = "lidarnaut/Explore-v0", "lidarnaut/ExploreFrontiers-v0"


def find_spec(id: str) -> EnvSpec:
    """Return the `EnvSpec` of an id; `module:id` imports the module first. ValueError if module or id are unknown."""
    module, _, name = id.rpartition(":")
    if module and not name.startswith(("/", "\\")):
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            raise ValueError(f"id {id!r}: there is no module {error.name!r} in {os.getcwd()}") from error
    if name not in gymnasium.registry:
        known = [one for one in gymnasium.registry if one.startswith((f"{name.partition('/')[0]}/", "lidarnaut/"))]
        raise ValueError(f"unknown id {explain_unknown(name, known)}, or module:id of your own")
    return gymnasium.registry[name]


@cache
def arguments_of(id: str) -> dict[str, Any]:
    """Return the arguments of an environment with their values, from its registration or else defaults.

    Includes arguments of base classes and of the task; if all accept further `**kwargs`, also those of `Explore-v0`.
    """
    spec = find_spec(id)
    assert spec.entry_point is not None
    creator: Any = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    classes = [one for one in getattr(creator, "__mro__", ()) if one is not object and "__init__" in vars(one)]
    makers, task = classes or [creator], spec.kwargs.get("task")
    found: dict[str, Any] = {}
    for make in makers if task is None else (makers[0], resolve(task, {}, "task")):
        parameters = inspect.signature(make).parameters.values()
        found = {one.name: one.default for one in parameters if one.kind is not one.VAR_KEYWORD} | found
        if all(one.kind is not one.VAR_KEYWORD for one in parameters):
            return found | spec.kwargs
    return arguments_of(EXPLORE) | found | spec.kwargs
