"""Validation of hyperparameters before training."""

import contextlib
import inspect
import json
import math
from typing import Any, get_args

from pydantic import ConfigDict, PydanticUserError, TypeAdapter

LOWEST = {"gradient_steps": -1, "learning_starts": 0, "sde_sample_freq": -1, "target_entropy": -math.inf}
LOWEST |= {"top_quantiles_to_drop_per_net": 0}
"""Lower bounds of hyperparameters, by name; the default is 1 for integers and 0 for floats."""
SHARES = ("gamma", "gae_lambda", "tau", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps")
"""Names of hyperparameters with upper bound 1."""
_STRICT = ConfigDict(arbitrary_types_allowed=True, strict=True)


def check_hyperparameter(name: str, given: Any, value: Any, annotation: Any) -> None:
    """Raise ValueError if a hyperparameter has an invalid type or value.

    `given`: configured value. `value`: resulting argument of the algorithm. `annotation`: type annotation of the
    argument; any type is allowed if missing or a string.
    """
    json.dumps(given, allow_nan=False, default=str)
    if not (isinstance(annotation, str) or annotation is inspect.Parameter.empty):
        with contextlib.suppress(PydanticUserError):
            TypeAdapter(annotation, config=_STRICT).validate_python(value)
    least, most = LOWEST.get(name, int(int in (annotation, *get_args(annotation)))), 1 if name in SHARES else math.inf
    if isinstance(given, int | float) and not least <= given <= most:
        raise ValueError(f"must be a number from {least}" + (f" to {most}" if most < math.inf else ""))
