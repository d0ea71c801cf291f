"""Times one DDPG update of herd's networks by PyTorch and JAX on one thread, in rounds with herd's own bench."""

import bench

# Transitions, and about how long that takes.
BATCHES = ((64, 1500), (256, 4000))
PEERS = [
    ("PyTorch eager", "update_torch.py", "eager"),
    ("PyTorch tuned", "update_torch.py", "tuned"),
    ("PyTorch compiled", "update_torch.py", "compiled"),
    ("JAX jit", "update_jax.py"),
]


def start(work, batch, rows):
    """The peers that start; the others get a row that says why not."""
    found = []
    for name, *program in PEERS:
        bench.say(f"update: starting {name}, batch {batch}")
        try:
            found.append((name, bench.Peer(*program, batch)))
        except Exception as error:  # noqa: BLE001
            rows.append(bench.failed(work, name, error))
    return found


def measure(options):
    """The rows of the table, batch by batch."""
    rounds, seconds = (1, 1.0) if options.quick else (options.rounds, 3.0)
    herd = None if options.no_herd else bench.Bench("herd-learner", "ddpg")
    rows = [] if herd is None else threads_allowed(herd, rounds, seconds)
    # XLA starts threads of its own, whatever its flags say.
    bench.pin()
    for batch, expected_micros in BATCHES:
        work, missing = f"DDPG update, batch {batch}", []
        peers = start(work, batch, missing)
        times, threads = {"herd": []}, {}
        for number in range(rounds):
            bench.say(f"update: batch {batch}, round {number + 1}")
            if herd:
                for micros in herd.run(f"update/{batch}/ddpg", seconds, seconds * 1e6 / expected_micros).values():
                    times["herd"] += micros
            for name, peer in peers:
                found = peer.run(seconds)
                times.setdefault(name, []).extend(found["micros"])
                threads[name] = max(threads.get(name, 0.0), found["threads"])
        if times["herd"]:
            rows.append(line(work, "herd", times["herd"], "candle, mimalloc; clips gradients too"))
        for name, peer in peers:
            rows.append(line(work, name, times[name], f"{peer.ready['how']}; {threads[name]:.2f} threads busy"))
            peer.close()
        rows += missing
    return rows


def threads_allowed(herd, rounds, seconds):
    """herd's update where it may start one thread and where it may start two, turn by turn, on whichever core is free."""
    rows = []
    for batch, expected_micros in BATCHES:
        work, times = f"DDPG update, batch {batch}, any core", {1: [], 2: []}
        for number in range(rounds):
            bench.say(f"update: one thread and two, batch {batch}, round {number + 1}")
            for threads, found in times.items():
                samples = seconds * 1e6 / expected_micros
                for micros in herd.run(f"update/{batch}/ddpg", seconds, samples, threads=threads).values():
                    found += micros
        rows.append(line(work, "herd", times[1], "one thread allowed"))
        rows.append(line(work, "herd, two threads allowed", times[2], "an update stays on the thread that calls it"))
    return rows


def line(work, who, micros, note):
    """A row that also says how many updates a second that is."""
    return bench.row(work, who, "µs", micros, f"{1e6 / bench.quantile(micros, 0.5):.0f}/s; {note}")


def main():
    options = bench.arguments(
        __doc__, rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"}
    )
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
