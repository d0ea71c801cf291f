"""Times DDPG updates of herd's networks on a GPU: herd built with `cuda`, PyTorch with and without CUDA graphs.

Needs a GPU, a CUDA toolkit to build herd (docs/gpu.md) and PyTorch. Updates go to the GPU 32 at a time, then it is
waited for, by all alike; a figure is the time of one update. herd's minibatches come from the host's memory, as in
training; PyTorch has all transitions on the GPU.
"""

import shutil
import subprocess
import sys

import bench

TOGETHER = 32
BATCHES = (256, 1024, 4096)
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
    herd = None if options.no_herd else bench.Bench("herd-learner", "device", "cuda")
    rows = []
    for batch in BATCHES:
        work, missing, peers = f"DDPG update on a GPU, batch {batch}", [], []
        for name, words in PEERS:
            bench.say(f"gpu: starting {name}, batch {batch}")
            where = ["--device", "cuda", "--together", TOGETHER]
            try:
                peers.append((name, bench.Peer("update_torch.py", words[0], batch, *words[1:], *where, on_gpu=True)))
            except Exception as error:  # noqa: BLE001
                missing.append(bench.failed(work, name, error))
        times, notes = {}, {"herd": f"candle, {TOGETHER} updates an upload; clips gradients too"}
        for number in range(rounds):
            bench.say(f"gpu: batch {batch}, round {number + 1}")
            if herd:
                found = herd.run(f"device/cuda/{batch}/ddpg/{TOGETHER}", seconds, samples=30, on_gpu=True)
                for micros in found.values():
                    times.setdefault("herd", []).extend(micros)
            for name, peer in peers:
                times.setdefault(name, []).extend(peer.run(seconds)["micros"])
                notes[name] = peer.ready["how"]
        for name, micros in times.items():
            each = [micro / TOGETHER for micro in micros]
            note = f"{1e6 / bench.quantile(each, 0.5):.0f}/s; {notes[name]}"
            rows.append(bench.row(work, name, "µs", each, note, tail=False))
        for _, peer in peers:
            peer.close()
        rows += missing
    return rows


def main():
    options = bench.arguments(
        __doc__, rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"}
    )
    bench.say(f"gpu: {gpu()}")
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
