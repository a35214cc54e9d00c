"""Run an ONNX file: `policies.py onnxruntime|reference|openvino FILE`; reads and prints arrays by name."""

import json
import sys

import numpy as np

library, path = sys.argv[1:]
given = json.load(sys.stdin)
results = []
for batch in given:
    arrays = {name: np.array(value, dtype=np.float32) for name, value in batch.items()}
    if library == "onnxruntime":
        import onnxruntime

        found = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"]).run(None, arrays)
    elif library == "reference":
        from onnx.reference import ReferenceEvaluator

        found = ReferenceEvaluator(path).run(None, arrays)
    else:
        import openvino

        compiled = openvino.Core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
        answer = compiled(arrays)
        found = [answer[output] for output in compiled.outputs]
    results.append([np.asarray(one).tolist() for one in found])
print(json.dumps(results))
