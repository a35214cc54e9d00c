"""Recipes: settings that a configuration starts from, by environment id, in `configs/recipes/`."""

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from lidarnaut.agents.config import (
    OTHER_KINDS,
    RECIPES,
    DecisionNetworkConfig,
    GaussianNetworkConfig,
    NetworkConfig,
    TrajectoryNetworkConfig,
    merge,
)
from lidarnaut.envs import ENVIRONMENTS
from lidarnaut.envs.files import explain_unknown, load_object, read_mapping, resolve
from lidarnaut.envs.ids import EXPLORE, find_spec

DEPENDENT = {"world": ("world_size", "difficulty", "time_limit"), "robot": ("robots",), "robots": ("robot",)}
"""Arguments of a recipe that do not apply to another value of an argument."""
PPO_LIKE = {"PPO", "MaskablePPO", "RecurrentPPO"}
ON_POLICY = PPO_LIKE | {"A2C", "TRPO", "OnPolicyAlgorithm"}
SHARED = ("gamma", "gae_lambda", "n_steps")
"""Hyperparameters with the same meaning in all on-policy algorithms; the first applies to every algorithm."""
OFF_POLICY = {"num_envs": 64, "total_steps": 300_000}
"""Upper limits of settings with off-policy algorithms: these make four gradient steps per step of all
sub-environments, and need fewer environment steps than on-policy algorithms."""
MIN_VALIDATIONS = 4
"""Minimum number of validations, and of checkpoints, in trainings shorter than the recipe's."""

NAMING = ("experiment", "seed", "seeds", "environment.id")
"""Keys that do not count as changes of a recipe."""


def find_recipe(id: str) -> tuple[str | None, Mapping[str, Any]]:
    """Return the name of an id's recipe (None without one), and the arguments that the id sets and the recipe may not.

    An id without a file has the recipe of the first registered id with the same task.

    Raises:
        ValueError: if the id is unknown.
    """
    own = find_spec(id).kwargs
    id = id.rpartition(":")[2]
    alike = [one for one, (_, given) in ENVIRONMENTS.items() if given.get("task", "") == own.get("task")]
    names = [one.removeprefix("lidarnaut/") for one in (id, *alike)]
    name = next((one for one in names if one in RECIPES), None)
    return name, {} if name == names[0] else own


def with_recipe(data: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Merge a configuration with the recipe of its environment id, or with the one that its key `recipe` names.

    The configuration has precedence. Returns the merged configuration, and a text with the keys of the recipe, empty
    without a recipe (`recipe: null`, evolutions, ids without one).

    Raises:
        ValueError: if the recipe or the environment id is unknown.
    """
    own = {key: value for key, value in data.items() if key != "recipe"}
    sections = [own.get(key) or {} for key in ("environment", "hyperparameters", "network", "evaluation")]
    if own.get("algorithm") in OTHER_KINDS or not all(isinstance(one, Mapping) for one in sections):
        return own, ""  # `parse_config` reports the wrong type
    name, fixed = (data["recipe"], {}) if "recipe" in data else find_recipe(str(sections[0].get("id", EXPLORE)))
    if name is None:
        return own, ""
    if name not in RECIPES:
        raise ValueError(f"recipe: unknown recipe {explain_unknown(str(name), RECIPES)}, and null for none")
    whole = read_mapping(RECIPES[name])
    if (reward := sections[0].get("reward")) is not None:
        found = resolve(reward, {}, "reward")
        own["environment"] = {**sections[0], "reward": found if isinstance(found, Mapping) else {"class": reward}}
    kept = _applicable(whole, own, fixed)
    _shorten_intervals(kept, own)
    used, changed = dict(flat(kept)), [key for key, _ in flat(own) if key not in NAMING]
    unused = [key for key in dict(flat(whole)) if key not in used and key not in changed]
    lists = {"changed by you": changed, "does not apply, so that defaults hold": unused}
    text = f"recipe {name}: {', '.join(f'{key} {value}' for key, value in used.items() if key not in changed)}"
    text += "".join(f"; {title}: {', '.join(keys)}" for title, keys in lists.items() if keys)
    return {"experiment": name, **merge(kept, own), "recipe": name}, text


def flat(section: Mapping[str, Any], above: str = "") -> Iterable[tuple[str, Any]]:
    """Yield keys, with dots between nested names, and values of a configuration."""
    for name, value in section.items():
        if isinstance(value, Mapping) and name != "observations":
            yield from flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _applicable(recipe: Mapping[str, Any], own: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a recipe that applies to the algorithm and to the environment of a configuration."""
    kept = copy.deepcopy(dict(recipe))
    environment, evaluated = kept["environment"], kept["evaluation"].setdefault("environment", {})
    given = {**fixed, **(own.get("environment") or {})}
    tested = (own.get("evaluation") or {}).get("environment")
    for section, names in ((environment, given), (evaluated, [*given, *(tested or ())])):
        for name in [one for key in names for one in DEPENDENT.get(key, ())]:
            section.pop(name, None)
    if "world" in (tested or ()) and "time_limit" in environment and "time_limit" not in given:
        evaluated["time_limit"] = None
    kind = resolve((given.get("reward") or {}).get("class"), {}, "reward")
    for name in getattr(kind, "changes", ()):  # a class starts from the other weights of the recipe
        environment.get("reward", {}).pop(name, None)
    for name in fixed:
        environment.pop(name, None)
    for name in [one for one in evaluated if one in given]:  # a given value holds in evaluations as well
        value = evaluated.pop(name)
        if isinstance(value, Mapping) and isinstance(given[name], Mapping) and name != "observations":
            evaluated[name] = merge(value, given[name])
    algorithm, usual = str(own.get("algorithm", recipe["algorithm"])), recipe["algorithm"]
    bases = getattr(load_object(algorithm), "__mro__", ()) if ":" in algorithm else ()
    kinds = {algorithm, *(one.__name__ for one in bases)}
    if not kinds & (PPO_LIKE if usual in PPO_LIKE else {usual}):
        shared = SHARED if usual in ON_POLICY and kinds & ON_POLICY else SHARED[:1]
        values = kept.get("hyperparameters", {}).items()
        kept["hyperparameters"] = {key: value for key, value in values if key in shared}
        if usual in ON_POLICY and not kinds & ON_POLICY:
            kept |= {key: min(kept[key], most) for key, most in OFF_POLICY.items()}
    network, observed = kept.get("network", {}), environment.get("observations", ())
    before = _network(network, {usual}, observed)
    after = _network(network, kinds, given.get("observations") or observed)
    fits = before is after or (issubclass(before, NetworkConfig) and issubclass(after, NetworkConfig))
    allowed = after.model_fields if fits else {}
    kept["network"] = {key: value for key, value in network.items() if key in allowed}
    return kept


def _shorten_intervals(kept: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Lower the recipe's steps between validations and between checkpoints if a training is shorter than usual."""
    config = merge(kept, own)
    total, num_envs = config["total_steps"], config["num_envs"]
    default = 2048 if config["algorithm"] == "TRPO" or ":" in str(config["algorithm"]) else 128  # at most
    n_steps = (config.get("hyperparameters") or {}).get("n_steps", default)
    if not all(isinstance(one, int) for one in (total, num_envs, n_steps)) or total >= kept["total_steps"]:
        return  # `parse_config` reports the wrong type
    for section in (kept["evaluation"], kept["checkpoints"]):
        if -(-total // section["every"]) < MIN_VALIDATIONS:
            section["every"] = min(section["every"], max(total // MIN_VALIDATIONS, num_envs * n_steps))


def _network(network: Mapping[str, Any], kinds: set[str], observations: Any) -> type[BaseModel]:
    """Return the class of network settings for an algorithm, given the names of its base classes."""
    chooses = kinds & {"PPO", "A2C"}
    if chooses and "trajectories" in observations:
        return TrajectoryNetworkConfig
    if chooses and {"heads", "prior", "prior_policy"} & network.keys():
        return DecisionNetworkConfig
    return GaussianNetworkConfig if kinds & ON_POLICY else NetworkConfig
