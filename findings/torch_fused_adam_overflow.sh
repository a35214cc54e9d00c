#!/usr/bin/env bash
# torch 2.13.0: Adam with `fused=True` takes a learning rate beyond the range of float32, which `fused=False` refuses.
#
# A learning rate of 1e39 is a valid Python float. A step of the default optimizer raises RuntimeError ("value cannot be
# converted to type float without overflow") and leaves the weights as they are; the fused one says nothing, and the
# weights are infinite after one step. A program that tries a step to check a learning rate has to try it without
# `fused`.
#
# Seen: {"default": "RuntimeError, weights [1.0, 1.0]", "fused": "weights [-inf, -inf]"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

import torch

found = {}
for name, fused in (("default", False), ("fused", True)):
    weights = torch.nn.Parameter(torch.ones(2))
    weights.grad = torch.ones(2)
    said = ""
    try:
        torch.optim.Adam([weights], lr=1e39, fused=fused).step()
    except RuntimeError:
        said = "RuntimeError, "
    found[name] = f"{said}weights {weights.tolist()}"
print(json.dumps(found))
sys.exit(found != {"default": "RuntimeError, weights [1.0, 1.0]", "fused": "weights [-inf, -inf]"})
PYTHON
