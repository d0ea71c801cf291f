"""Times DDPG updates of herd's networks on a GPU: herd built with `cuda`, PyTorch with and without CUDA graphs.

Needs a GPU, NVRTC (docs/gpu.md) and PyTorch. Updates go to the GPU 32 at a time, then it is waited for, by all alike; a
figure is the time of one update. All keep the transitions on the GPU and compute in float32; herd draws minibatches on
the host, PyTorch on the GPU.
"""

import shutil
import subprocess
import sys

import bench

TOGETHER = 32
# Transitions, and about how long herd takes for all updates together, in microseconds.
BATCHES = ((256, 2000), (1024, 4000), (4096, 12000))
PEERS = [
    ("PyTorch tuned", ["tuned"]),
    ("PyTorch with CUDA graphs", ["tuned", "--graphs"]),
    ("PyTorch compiled, with CUDA graphs", ["compiled", "--graphs"]),
]


def gpu():
    """The GPU's name; ends the script where there is none."""
    query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    found = subprocess.run(query, capture_output=True, text=True, check=False) if shutil.which(query[0]) else None
    if found is None or found.returncode or not found.stdout.strip():
        sys.exit("update_gpu.py: no GPU here (nvidia-smi finds none); nothing was measured")
    return found.stdout.strip().splitlines()[0]


def measure(options):
    """The rows of the table, batch by batch."""
    rounds, seconds = (1, 1.0) if options.quick else (options.rounds, 3.0)
    herd = None if options.no_herd else bench.Bench("herd-learner", "device", "cuda", program=options.bench)
    rows = []
    for batch, expected_micros in BATCHES:
        work, missing, peers = f"DDPG update on a GPU, batch {batch}", [], []
        for name, words in PEERS[: 2 if options.no_compiled else None]:
            bench.say(f"gpu: starting {name}, batch {batch}")
            where = ["--device", "cuda", "--together", TOGETHER]
            try:
                peers.append((name, bench.Peer("update_torch.py", words[0], batch, *words[1:], *where, on_gpu=True)))
            except Exception as error:  # noqa: BLE001
                missing.append(bench.failed(work, name, error))
        times, notes = {}, {"herd": "clips gradients too"}
        for number in range(rounds):
            bench.say(f"gpu: batch {batch}, round {number + 1}")
            if herd:
                samples = seconds * 1e6 / expected_micros
                found = herd.run(f"device/cuda/{batch}/ddpg/{TOGETHER}", seconds, samples, on_gpu=True)
                for micros in found.values():
                    times.setdefault("herd", []).extend(micros)
            for name, peer in peers:
                times.setdefault(name, []).extend(peer.run(seconds)["micros"])
                notes[name] = peer.ready["how"]
        for name, micros in times.items():
            each = [micro / TOGETHER for micro in micros]
            note = f"{1e6 / bench.quantile(each, 0.5):.0f}/s; {notes[name]}"
            rows.append(bench.row(work, name, "µs", each, note))
        for _, peer in peers:
            peer.close()
        rows += missing
        # What is there so far: PyTorch's compiler may take longer than the GPU is at hand.
        bench.say(bench.markdown(rows))
    return rows


def main():
    options = bench.arguments(
        __doc__,
        rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"},
        no_compiled={"action": "store_true", "help": "leave out what PyTorch compiles, which takes minutes to start"},
        bench={"help": "herd's bench `device`, built elsewhere; without it cargo builds it"},
    )
    bench.say(f"gpu: {gpu()}")
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
