"""End to end: steps a second that are trained on, by Stable-Baselines3's DDPG without any physics and by `herd train`.

Both take one update a step with the same networks and batch, plain DDPG. herd's one learner and one actor simulate the
robot besides, in two processes; SB3 is measured with one thread and with two.
"""

import json
import os
import pathlib
import subprocess
import tempfile

import bench

BATCH = 64
WORK = "trained steps, end to end"
PLAIN = ["ddpg.twin_critic=false", "ddpg.actor_every=1", "ddpg.smoothing_sigma=0", f"ddpg.warmup_transitions={BATCH}"]


def build():
    """herd's binary."""
    subprocess.run(["cargo", "build", "--quiet", "--locked", "--release", "-p", "herd"], cwd=bench.ROOT, check=True)
    return pathlib.Path(os.environ.get("CARGO_TARGET_DIR", bench.ROOT / "target")) / "release" / "herd"


def herd(program, episodes):
    """Updates a second of a run of so many episodes, by its own account at the end."""
    with tempfile.TemporaryDirectory() as directory:
        sets = [word for setting in PLAIN for word in ("--set", setting)]
        command = [program, "train", "--run-dir", directory, "--episodes", str(episodes), "--json", *sets]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return json.loads(done.stdout.splitlines()[-1])["status"]["rates"]["updates"]


def measure(options):
    """The rows of the table."""
    rounds, seconds, episodes = (1, 2.0, 15) if options.quick else (options.rounds, 5.0, 100)
    rates, rows, peers = {"herd": []}, [], []
    program = None if options.no_herd else build()
    for threads in (1, 2):
        name = f"SB3 DDPG, no physics, {threads} thread{'s'[: threads - 1]}"
        try:
            peers.append((name, bench.Peer("sb3_env.py", BATCH, threads)))
        except Exception as error:  # noqa: BLE001
            rows.append(bench.failed(WORK, name, error))
    for number in range(rounds):
        bench.say(f"sb3: round {number + 1}")
        if program:
            rates["herd"].append(herd(program, episodes))
        for name, peer in peers:
            micros = peer.run(seconds)["micros"]
            rates.setdefault(name, []).extend(peer.ready["steps"] * 1e6 / m for m in micros)
    notes = {name: f"{peer.ready['how']}, batch {BATCH}" for name, peer in peers}
    notes["herd"] = f"physics included, batch {BATCH}, one learner, one actor"
    for _, peer in peers:
        peer.close()
    measured = [(name, values) for name, values in rates.items() if values]
    return [bench.row(WORK, name, "steps/s", values, notes[name], tail=False) for name, values in measured] + rows


def main():
    options = bench.arguments(
        __doc__, rounds={"type": int, "default": 3, "help": "rounds of herd and SB3 (default 3)"}
    )
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
