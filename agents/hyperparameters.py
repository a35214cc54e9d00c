"""Checks of hyperparameters, which the libraries make late, or not at all."""

import contextlib
import inspect
import json
import math
from typing import Any, get_args

from pydantic import ConfigDict, PydanticUserError, TypeAdapter

LEAST = {"gradient_steps": -1, "learning_starts": 0, "sde_sample_freq": -1, "target_entropy": -math.inf}
LEAST |= {"top_quantiles_to_drop_per_net": 0}
"""Lowest allowed values by name. Of others it is 1 for whole numbers, and 0."""
SHARES = ("gamma", "gae_lambda", "tau", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps")
"""Names of values that are at most 1."""
_STRICT = ConfigDict(arbitrary_types_allowed=True, strict=True)


def check_hyperparameter(name: str, given: Any, value: Any, annotation: Any) -> None:
    """Compare a value with the type of its argument and with its limits.

    `given` is the value in the configuration, `value` the one that the algorithm gets. An `annotation` that is missing
    or a string allows any type.

    Raises:
        ValueError: the type differs, or a number is too low, too high or not finite; names the allowed values.
    """
    json.dumps(given, allow_nan=False, default=str)
    if not (isinstance(annotation, str) or annotation is inspect.Parameter.empty):
        with contextlib.suppress(PydanticUserError):  # of an annotation that pydantic does not know
            TypeAdapter(annotation, config=_STRICT).validate_python(value)
    least, most = LEAST.get(name, int(int in (annotation, *get_args(annotation)))), 1 if name in SHARES else math.inf
    if isinstance(given, int | float) and not least <= given <= most:
        raise ValueError(f"must be a number from {least}" + (f" to {most}" if most < math.inf else ""))
