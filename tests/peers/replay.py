"""Replay memories side by side: transitions put in a second, µs to draw a minibatch of 256."""

import bench

INSERT, SAMPLE = "replay, put in", "replay, draw 256"
PEERS = {"cpprb": ".venv", "torchrl": ".venv", "reverb": ".venv-reverb"}


def start(rows):
    """The peers that start; the others get a row that says why not."""
    found = {}
    for name, venv in PEERS.items():
        bench.say(f"replay: starting {name}")
        try:
            found[name] = bench.Peer("replay_peer.py", name, python=bench.HERE / venv / "bin" / "python")
        except Exception as error:  # noqa: BLE001
            rows.append(bench.failed(INSERT, name, error))
    return found


def measure(options):
    """The rows of the table."""
    rounds, seconds = (1, 2.0) if options.quick else (options.rounds, 6.0)
    herd = None if options.no_herd else bench.Bench("herd-learner", "replay")
    missing, rates, draws = [], {"herd": []}, {"herd": []}
    peers = start(missing)
    for number in range(rounds):
        bench.say(f"replay: round {number + 1}")
        if herd:
            rates["herd"] += [1000e6 / m for m in herd.run("replay/push/1000", seconds / 2)["replay/push/1000"]]
            draws["herd"] += herd.run("replay/sample/256", seconds / 2)["replay/sample/256"]
        for name, peer in peers.items():
            found = peer.run(seconds)
            rates.setdefault(name, []).extend(1000e6 / m for m in found["insert"])
            draws.setdefault(name, []).extend(found["sample"])
    hows = {"herd": "in memory; its journal is measured elsewhere"}
    hows |= {name: peer.ready["how"] for name, peer in peers.items()}
    hows["reverb"] = hows.get("reverb", "") + ", client and server in one process by gRPC"
    for peer in peers.values():
        peer.close()
    rows = [bench.row(INSERT, n, "transitions/s", v, hows[n], tail=False) for n, v in rates.items() if v]
    rows += [bench.row(SAMPLE, n, "µs", v, hows[n], tail=n != "herd") for n, v in draws.items() if v]
    return rows + missing


def main():
    options = bench.arguments(
        __doc__, rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"}
    )
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
