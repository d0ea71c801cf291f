"""Inserts transitions into one peer's replay memory and draws minibatches of 256, for as long as it is asked.

A transition is 56 observations, 4 actions, reward, discount, 56 next observations, float32; 1,000 are put in at a time
where the library takes many. Answers with microseconds of an insertion of 1,000 and of a sample of 256.
"""

import argparse
import json
import sys
import time

import bench
import ddpg_work
import numpy as np

CAPACITY, CHUNK, SAMPLE = 200_000, 1000, 256
FIELDS = {"observation": 56, "action": 4, "reward": 1, "discount": 1, "next_observation": 56}


def chunk():
    """1,000 transitions by field."""
    return {name: column[:CHUNK] for name, column in zip(FIELDS, ddpg_work.replay(), strict=True)}


def cpprb():
    """cpprb's ReplayBuffer."""
    import cpprb

    names = {"observation": "obs", "action": "act", "reward": "rew", "discount": "disc", "next_observation": "next"}
    buffer = cpprb.ReplayBuffer(CAPACITY, {names[n]: {"shape": w, "dtype": np.float32} for n, w in FIELDS.items()})
    data = {names[name]: column for name, column in chunk().items()}
    return lambda: buffer.add(**data), lambda: buffer.sample(SAMPLE), bench.version("cpprb")


def torchrl():
    """TorchRL's TensorDictReplayBuffer on LazyTensorStorage."""
    import tensordict
    import torch
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

    torch.set_num_threads(1)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(CAPACITY), batch_size=SAMPLE)
    data = tensordict.TensorDict({n: torch.from_numpy(c) for n, c in chunk().items()}, batch_size=[CHUNK])
    return lambda: buffer.extend(data), buffer.sample, bench.version("torchrl")


def reverb():
    """A Reverb server in this process; its client writes items one by one, as it must; a dataset-less sampler reads."""
    import reverb as library

    table = library.Table(
        "replay", library.selectors.Uniform(), library.selectors.Fifo(), CAPACITY, library.rate_limiters.MinSize(1)
    )
    server = library.Server([table])
    client = library.Client(f"localhost:{server.port}")
    columns = chunk()
    steps = [{name: column[i] for name, column in columns.items()} for i in range(CHUNK)]
    writer = client.trajectory_writer(num_keep_alive_refs=1)

    def insert():
        for step in steps:
            writer.append(step)
            writer.create_item("replay", 1.0, {name: values[-1:] for name, values in writer.history.items()})
        # An item that is not flushed is not stored yet.
        writer.flush()

    def sample():
        for _ in client.sample("replay", SAMPLE, emit_timesteps=False):
            pass

    sample.server = server
    return insert, sample, bench.version("dm-reverb")


def timed(work, seconds):
    """Microseconds of each run of `work`."""
    end, micros = time.perf_counter() + seconds, []
    while (start := time.perf_counter()) < end:
        work()
        micros.append((time.perf_counter() - start) * 1e6)
    return micros


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", choices=["cpprb", "torchrl", "reverb"])
    insert, sample, how = {"cpprb": cpprb, "torchrl": torchrl, "reverb": reverb}[parser.parse_args().library]()
    # herd's memory is full too when it is measured, and greater than any cache.
    fills = 3 if parser.parse_args().library == "reverb" else CAPACITY // CHUNK
    for _ in range(fills):
        insert()
    sample()
    print(json.dumps({"how": how}), flush=True)
    for line in sys.stdin:
        seconds = float(line) / 2
        print(json.dumps({"insert": timed(insert, seconds), "sample": timed(sample, seconds)}), flush=True)


if __name__ == "__main__":
    main()
