"""The exported policy in ONNX Runtime: parity with herd's golden vectors, and an actor for `herd drive`."""

import json
import pathlib
import tempfile

import herd
import numpy as np
import onnxruntime

TOLERANCE = 1e-5


class Policy:
    """The policy of a run as ONNX."""

    def __init__(self, run_dir):
        with tempfile.TemporaryDirectory() as directory:
            file = pathlib.Path(directory) / "policy.onnx"
            herd.call("export", "policy", "--run-dir", run_dir, "--out", file)
            self.golden = json.loads(file.with_suffix(".golden.json").read_text())
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = 1
            self.session = onnxruntime.InferenceSession(file.read_bytes(), options, ["CPUExecutionProvider"])

    def act(self, observation):
        """The action for one observation."""
        return self.run([observation])[0].tolist()

    def run(self, observations):
        """Actions, each a row."""
        return self.session.run(["action"], {"observation": np.array(observations, dtype=np.float32)})[0]

    def parity(self):
        """How far ONNX Runtime is from herd on the golden vectors, and what the model says of itself."""
        apart = np.abs(self.run(self.golden["observations"]) - np.array(self.golden["actions"], dtype=np.float32)).max()
        said = self.session.get_modelmeta().custom_metadata_map
        named = said["task_hash"] == self.golden["task_hash"] and int(said["version"]) == self.golden["version"]
        return {
            "vectors": len(self.golden["observations"]),
            "max_difference": float(apart),
            "tolerance": TOLERANCE,
            "holds": bool(apart <= TOLERANCE and named),
            "metadata": {key: said[key] for key in ("task", "task_hash", "run", "version", "seed")},
        }
