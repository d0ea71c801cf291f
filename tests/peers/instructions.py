"""Counts the instructions of herd's hot paths under callgrind and compares them with a committed baseline.

Counts hardly depend on how busy the machine is, so that they show a regression where times do not. Valgrind offers
AVX2 and no AVX-512, whatever the processor has: kernels that choose by processor are counted as AVX2 runs them. Each
path is one iteration of herd's own bench, by criterion's `--test`; what leads up to it is not counted.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile

import bench

BASELINE = bench.HERE / "instructions.json"
TOLERANCE = 0.03
# Name: package, bench, which benchmark of it, by how many the count is divided.
PATHS = {
    "control tick": ("herd-actor", "control_tick", "control_tick/swing of 75 ticks", 75),
    "MPC, trot": ("herd-actor", "mpc", "mpc/trot/active_set", 1),
    "MPC, four feet": ("herd-actor", "mpc", "mpc/four_feet/active_set", 1),
    "policy, forward": ("herd-actor", "decision", "policy", 1),
    "DDPG update, batch 64": ("herd-learner", "ddpg", "update/64/ddpg", 1),
    "DDPG update, batch 256": ("herd-learner", "ddpg", "update/256/ddpg", 1),
    "TD3 update, critics only": ("herd-learner", "ddpg", "update/64/td3", 1),
    "replay, draw 256": ("herd-learner", "replay", "replay/sample/256", 1),
}
# Criterion's loop about the benchmarked closure, with --test of one turn: the same whatever herd's own code inlines.
COUNTED = "criterion::bencher::Bencher<*>::iter"


def count(program, only):
    """Instructions of one iteration of a benchmark."""
    with tempfile.TemporaryDirectory() as directory:
        done = subprocess.run(
            ["valgrind", "--tool=callgrind", f"--callgrind-out-file={directory}/out.%p",
             f"--toggle-collect={COUNTED}", program, "--bench", "--test", "--exact", only],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, check=False,
            env={**os.environ, **bench.ONE_THREAD, "CRITERION_HOME": directory},
        )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{only}: {(done.stderr.strip().splitlines() or ['no word'])[-1]}")
    # A child that criterion forks reports too, with nothing collected.
    collected = max(int(number) for number in re.findall(r"Collected : (\d+)", done.stderr))
    if not collected:
        raise RuntimeError(f"{only}: nothing counted; is {COUNTED} a function of its own?")
    return collected


def table(found, baseline):
    """Counts beside the baseline."""
    lines = ["| path | instructions | baseline | change |", "|---|---:|---:|---:|"]
    for name, number in found.items():
        before = baseline.get(name)
        change = f"{number / before - 1:+.1%}" if before else "new"
        lines.append(f"| {name} | {number:,} | {f'{before:,}' if before else '–'} | {change} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bless", action="store_true", help=f"make these counts the baseline, {BASELINE.name}")
    parser.add_argument("--quick", action="store_true", help="leave out the updates, which take the longest")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, help=f"share allowed (default {TOLERANCE})")
    options = parser.parse_args()
    if shutil.which("valgrind") is None:
        sys.exit("valgrind is not installed")
    programs, found, lost = {}, {}, []
    for name, (package, bench_name, only, parts) in PATHS.items():
        if options.quick and "update" in name:
            continue
        bench.say(f"instructions: {name}")
        try:
            if bench_name not in programs:
                programs[bench_name] = bench.Bench(package, bench_name).program
            found[name] = count(programs[bench_name], only) // parts
        except RuntimeError as error:
            lost.append(str(error))
    baseline = json.loads(BASELINE.read_text(encoding="utf-8")) if BASELINE.exists() else {}
    print(table(found, baseline))
    if options.bless:
        BASELINE.write_text(json.dumps(baseline | found, indent=2) + "\n", encoding="utf-8")
        baseline = found
    more = [name for name, number in found.items() if number > (1 + options.tolerance) * baseline.get(name, number)]
    less = [name for name, number in found.items() if number < (1 - options.tolerance) * baseline.get(name, number)]
    for words, names in (("not counted", lost), ("more than the baseline", more), ("less: bless it", less)):
        for name in names:
            print(f"{words}: {name}", file=sys.stderr)
    sys.exit(1 if lost or more else 0)


if __name__ == "__main__":
    main()
