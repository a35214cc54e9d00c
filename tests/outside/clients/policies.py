"""ONNX files by three runtimes."""

import numpy as np
from onnx.reference import ReferenceEvaluator
from onnxruntime import InferenceSession
from openvino import Core


def run(runtime, path, batches):
    """Return the outputs for each batch of arrays by name."""
    batches = [{name: np.array(value, dtype=np.float32) for name, value in batch.items()} for batch in batches]
    if runtime == "openvino":
        infer = Core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
        return [list(infer(batch).values()) for batch in batches]
    session = ReferenceEvaluator(path) if runtime == "onnx" else InferenceSession(path)
    return [session.run(None, batch) for batch in batches]
