"""One tick of 2 ms of herd's robot: herd with controller and MPC, MuJoCo and PyBullet with hardly any control."""

import bench
import quadruped

WORK = "tick of 2 ms"
PEERS = [
    ("MuJoCo, its own joint control", "mujoco", "alone"),
    ("MuJoCo, PD in numpy", "mujoco", "pd"),
    ("PyBullet, its own joint motors", "pybullet", "alone"),
    ("PyBullet, PD in numpy", "pybullet", "pd"),
]


def measure(options):
    """The rows of the table."""
    rounds, seconds = (1, 1.0) if options.quick else (options.rounds, 3.0)
    herd = None if options.no_herd else bench.Bench("herd-actor", "control_tick")
    bench.pin()
    peers, missing, times = {}, [], {"herd": []}
    for name, *words in PEERS:
        try:
            peers[name] = bench.Peer("physics_peer.py", *words)
        except Exception as error:  # noqa: BLE001
            missing.append(bench.failed(WORK, name, error))
    for number in range(rounds):
        bench.say(f"physics: round {number + 1}")
        if herd:
            # A swing takes some milliseconds, so that each sample is of one.
            for micros in herd.run("control_tick", seconds, seconds * 1e6 / 2500).values():
                times["herd"] += micros
        for name, peer in peers.items():
            times.setdefault(name, []).extend(peer.run(seconds)["micros"])
    notes = {"herd": "rapier, state estimate, gait, torques, MPC as often as it is due"}
    notes |= {n: f"{p.ready['how']}, trunk at {p.ready['height']:.2f} m; no MPC" for n, p in peers.items()}
    for peer in peers.values():
        peer.close()
    ticks = quadruped.SWING_TICKS
    rows = [bench.row(WORK, n, "µs", [v / ticks for v in values], notes[n]) for n, values in times.items() if values]
    return rows + missing


def main():
    options = bench.arguments(
        __doc__, rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"}
    )
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
