#!/usr/bin/env bash
# numba 0.68.1: an assignment expression that names a computed value cannot be an operand in compiled code.
#
# `if (total := a[0] + a[1]) < a[2]` is valid Python, and `total` is a number. `njit` raises TypingError, "Type of
# variable ... cannot be determined", for the value as operand of a comparison or a sum, as argument and as condition. If
# another variable is given a second name, it works. The same was reported in 2021 (numba issue 6895), and repaired then.
# In kernels, assign the value in a line of its own.
#
# Seen: {"python": true, "named_variable": 1.0, "comparison": "TypingError", "sum": "TypingError", "argument":
# "TypingError", "condition": "TypingError"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet numba==0.68.1 numpy==2.4.6
cat > "$folder/kernels.py" <<'PYTHON'
import json
import sys

import numpy as np
from numba import njit
from numba.core.errors import TypingError


def named_variable(a):
    value = a[1]
    if (other := value) < a[2]:
        return other
    return 0.0


def comparison(a):
    if (total := a[0] + a[1]) < a[2]:
        return total
    return 0.0


def addition(a):
    twice = (total := a[0] + a[1]) + 1.0
    return total + twice


def argument(a):
    return max((total := a[0] + a[1]), 0.5) + total


def condition(a):
    if total := a[0] + a[1]:
        return total
    return 0.0


def outcome(function):
    try:
        return float(njit(function)(np.arange(4.0)))
    except TypingError as error:
        assert "cannot be determined" in str(error)
        return "TypingError"


kernels = {"named_variable": named_variable, "comparison": comparison, "sum": addition}
kernels |= {"argument": argument, "condition": condition}
results = [float(kernel(np.arange(4.0))) for kernel in kernels.values()]
found = {"python": results == [1.0, 1.0, 3.0, 2.0, 1.0]}
found |= {name: outcome(kernel) for name, kernel in kernels.items()}
print(json.dumps(found))
wanted = dict.fromkeys(kernels, "TypingError") | {"python": True, "named_variable": 1.0}
sys.exit(found != wanted)
PYTHON
"$folder/venv/bin/python" "$folder/kernels.py"
