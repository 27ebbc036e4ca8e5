#!/usr/bin/env python3
"""Reads an exported policy with independent software and compares it with our own outputs.

usage: onnx_check.py MODEL EXPECTED
EXPECTED is a text file: first line N O L, then N lines of O observations, L logits, 1 value, the actions.
The model is checked by onnx.checker and run by onnxruntime if that is installed, else by the few numpy lines below.
Exit codes: 0 agrees, 1 differs, 77 the onnx package is missing.
"""
import math
import re
import sys

try:
    import numpy as np
    import onnx
    from onnx import numpy_helper
except ImportError:
    print("python3-onnx is not installed")
    sys.exit(77)


def run_numpy(model, observation):
    values = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    values["observation"] = observation
    for node in model.graph.node:
        inputs = [values[name] for name in node.input]
        attributes = {a.name: list(a.ints) or a.i for a in node.attribute}
        if node.op_type == "Identity":
            outputs = [inputs[0]]
        elif node.op_type == "Sub":
            outputs = [inputs[0] - inputs[1]]
        elif node.op_type == "Mul":
            outputs = [inputs[0] * inputs[1]]
        elif node.op_type == "Clip":
            outputs = [np.clip(*inputs)]
        elif node.op_type == "Gemm":
            right = inputs[1].T if attributes.get("transB") else inputs[1]
            outputs = [inputs[0] @ right + (inputs[2] if len(inputs) > 2 else 0)]
        elif node.op_type == "Tanh":
            outputs = [np.tanh(inputs[0])]
        elif node.op_type == "Sigmoid":
            outputs = [1 / (1 + np.exp(-inputs[0]))]
        elif node.op_type == "Split":
            outputs = np.split(inputs[0], np.cumsum(inputs[1])[:-1], axis=attributes["axis"])
        elif node.op_type == "ArgMax":
            outputs = [np.argmax(inputs[0], axis=attributes["axis"])[:, None]]
        elif node.op_type == "Reshape":
            outputs = [inputs[0].reshape(inputs[1])]
        elif node.op_type == "Transpose":
            outputs = [inputs[0].transpose(attributes["perm"])]
        elif node.op_type == "Abs":
            outputs = [np.abs(inputs[0])]
        elif node.op_type == "Less":
            outputs = [inputs[0] < inputs[1]]
        elif node.op_type == "Cast":
            outputs = [inputs[0].astype(np.float32)]
        elif node.op_type == "Conv":
            windows = np.lib.stride_tricks.sliding_window_view(inputs[0], attributes["kernel_shape"], axis=(2, 3))
            down, across = attributes["strides"]
            sums = np.einsum("ncyxuv,fcuv->nfyx", windows[:, :, ::down, ::across], inputs[1])
            outputs = [sums + inputs[2][None, :, None, None]]
        elif node.op_type == "Concat":
            outputs = [np.concatenate(inputs, axis=attributes["axis"])]
        else:
            raise ValueError("unexpected node " + node.op_type)
        values.update(zip(node.output, outputs))
    return values["logits"], values["value"], values["action"]


def main():
    model = onnx.load(sys.argv[1])
    onnx.checker.check_model(model, full_check=True)
    with open(sys.argv[2]) as file:
        _, observations, logits = (int(word) for word in file.readline().split())
        rows = np.array([[float(word) for word in line.split()] for line in file])
    observation = rows[:, :observations].astype(np.float32)
    expected = np.split(rows, [observations, observations + logits, observations + logits + 1], axis=1)[1:]
    try:
        import onnxruntime

        got = onnxruntime.InferenceSession(sys.argv[1], providers=["CPUExecutionProvider"]).run(
            ["logits", "value", "action"], {"observation": observation})
        engine = "onnxruntime"
    except ImportError:
        got = run_numpy(model, observation)
        engine = "numpy"
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    for key in ("policy_version", "weights_hash", "config_hash", "observation_names", "observation_units", "action_names"):
        if key not in metadata:
            print("metadata lacks", key)
            return 1
    names = metadata["observation_names"].split(",")
    # A picture is one entry, whose name ends in its shape.
    named = sum(math.prod(int(side) for side in re.findall(r"\[(\d+)\]", name)) for name in names)
    if named != observations or len(metadata["observation_units"].split(",")) != len(names):
        print("names and units are not of", observations, "observations:", names, metadata["observation_units"])
        return 1
    largest = max(float(np.abs(a - b).max()) for a, b in zip(got, expected))
    print(f"{engine}: largest difference {largest:.3g} over {len(rows)} observations")
    return 0 if largest < 2e-5 else 1  # f32 sums of 128 terms in another order


if __name__ == "__main__":
    sys.exit(main())
