"""Checks of hyperparameters, which the libraries make late, or not at all."""

import inspect
import json
import math
import re
from typing import Any, get_args

from pydantic import ConfigDict, PydanticUserError, TypeAdapter

from lidarnaut.envs.files import SHORT

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
    if isinstance(annotation, str) or annotation is inspect.Parameter.empty:
        annotation = Any
    is_whole = int in (annotation, *get_args(annotation))
    least, most = LEAST.get(name, int(is_whole)), 1 if name in SHARES else math.inf
    try:
        json.dumps(given, allow_nan=False, default=str)
        is_right = not isinstance(given, int | float) or least <= given <= most
        TypeAdapter(annotation, config=_STRICT).validate_python(value)
    except PydanticUserError:  # of an annotation that pydantic does not know
        pass
    except ValueError:
        is_right = False
    if not is_right:
        kind = "a whole number" if is_whole else re.sub(r"\b[a-z_0-9]+\.", "", inspect.formatannotation(annotation))
        kind = kind.replace("ActionNoise", "float | ActionNoise")
        limits = f" from {least}" + (" to 1" if most == 1 else "") if is_whole or "float" in kind else ""
        finite = " of finite numbers" if "dict" in kind else ""
        raise ValueError(f"hyperparameters.{name} must be {kind}{limits}{finite}, got {SHORT.repr(given)}")
