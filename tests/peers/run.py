"""Runs every comparison with the peers and prints one Markdown table: medians, p99, how many times as fast herd is."""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import bench

COMPARISONS = ["qp", "physics", "update", "sb3", "replay"]


def compare(name, options, directory):
    """The rows of one comparison, which runs in a process of its own."""
    path = pathlib.Path(directory) / f"{name}.json"
    command = [sys.executable, str(bench.HERE / f"{name}.py"), "--json", str(path)]
    command += ["--quick"] if options.quick else []
    command += ["--no-herd"] if options.no_herd else []
    if name == "qp" and options.dump_program:
        command += ["--dump-program", str(options.dump_program.resolve())]
    bench.say(f"== {name}")
    done = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    if done.returncode or not path.exists():
        return [bench.failed(name, name, f"{name}.py ended with {done.returncode}")]
    return [bench.Row(**row) for row in json.loads(path.read_text(encoding="utf-8"))]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seconds a peer, for trying the scripts out")
    parser.add_argument("--no-herd", action="store_true", help="peers only; builds and runs nothing of herd's")
    parser.add_argument("--out", type=pathlib.Path, help="write the table to this file")
    parser.add_argument("--only", nargs="+", choices=COMPARISONS, default=COMPARISONS, help="just these")
    parser.add_argument("--dump-program", type=pathlib.Path, help="herd's example dump_qps, already built")
    options = parser.parse_args()
    head, rows = bench.machine(), []
    with tempfile.TemporaryDirectory() as directory:
        for name in options.only:
            rows += compare(name, options, directory)
    text = f"Machine: {head}. One thread each unless said.\n\n{bench.markdown(rows)}\n"
    print(text)
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
