"""ONNX files by three runtimes."""

from functools import partial

import numpy as np


def run(runtime, path, batches):
    """Return the outputs for each batch of arrays by name."""
    if runtime == "onnxruntime":
        from onnxruntime import InferenceSession

        infer = partial(InferenceSession(path, providers=["CPUExecutionProvider"]).run, None)
    elif runtime == "onnx":
        from onnx.reference import ReferenceEvaluator

        infer = partial(ReferenceEvaluator(path).run, None)
    else:
        from openvino import Core

        infer = Core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    found = [infer({name: np.array(value, dtype=np.float32) for name, value in batch.items()}) for batch in batches]
    return [list(one.values()) if runtime == "openvino" else one for one in found]
