"""What all comparisons share: figures, the one table, herd's own benches, peers that run in processes of their own."""

import argparse
import contextlib
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from importlib import metadata

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
# One thread for every one of them; set before any of them is imported.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    # Where there are two after all: threads that wait must not take the core from those that work.
    "OMP_WAIT_POLICY": "passive",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
    "CUDA_VISIBLE_DEVICES": "",
    "TF_CPP_MIN_LOG_LEVEL": "3",
}


@dataclass
class Row:
    """One line of the table. `unit` is a time (less is better) or ends in `/s` (more is better)."""

    work: str
    who: str
    unit: str = ""
    median: float | None = None
    p99: float | None = None
    note: str = ""
    # Why there is no figure.
    failed: str = ""


def quantile(values, q):
    """The value below which a share `q` of `values` lies."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))]


def row(work, who, unit, values, note="", tail=True):
    """A row from many measurements; `tail` says that each is of one run of the work, so that a p99 means something."""
    return Row(work, who, unit, quantile(values, 0.5), quantile(values, 0.99) if tail else None, note)


def failed(work, who, error):
    """A row for a peer that could not take part."""
    return Row(work, who, failed=" ".join(str(error).split())[:200] or type(error).__name__)


def version(package):
    """Name and version of an installed package."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"{package} (not installed)"


def machine():
    """The machine in one line."""
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        lines = [line.split(":", 1)[1].strip() for line in file if line.startswith(("model name", "model\t"))]
    name = f"{lines[1]} (model {lines[0]})" if len(lines) > 1 else platform.processor()
    load = os.getloadavg()[0]
    return f"{name}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}, load {load:.1f}"


def ratio(row, rows):
    """How many times as fast as this row herd is; None without a figure of herd's in the same unit."""
    herd = [r for r in rows if r.who == "herd" and r.work == row.work and r.unit == row.unit and r.median]
    if not herd or not row.median or row.who == "herd":
        return None
    quotient = row.median / herd[0].median
    return 1 / quotient if row.unit.endswith("/s") else quotient


def number(value):
    """Three significant digits, without an exponent."""
    if value is None:
        return "–"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def markdown(rows):
    """The table of ratios."""
    lines = ["| work | who | median | p99 | unit | herd is | note |", "|---|---|---:|---:|---|---:|---|"]
    for r in rows:
        if r.failed:
            lines.append(f"| {r.work} | {r.who} | – | – | – | – | not measured: {r.failed} |")
            continue
        times = ratio(r, rows)
        faster = "" if times is None else f"{times:.2f}×"
        lines.append(f"| {r.work} | {r.who} | {number(r.median)} | {number(r.p99)} | {r.unit} | {faster} | {r.note} |")
    return "\n".join(lines)


def arguments(description, **more):
    """The options that every comparison has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a few seconds a peer, for trying the scripts out")
    parser.add_argument("--no-herd", action="store_true", help="peers only; builds and runs nothing of herd's")
    parser.add_argument("--json", type=pathlib.Path, help="write the rows to this file too")
    for name, settings in more.items():
        parser.add_argument("--" + name.replace("_", "-"), **settings)
    return parser.parse_args()


def report(rows, options):
    """Prints the table and keeps the rows."""
    print(f"\n{machine()}\n\n{markdown(rows)}")
    if options.json:
        options.json.write_text(json.dumps([asdict(r) for r in rows], indent=1), encoding="utf-8")


def pin():
    """Keeps this process and all that it starts, herd and peers alike, on one core; call it once herd is built."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def say(text):
    """Tells on stderr how far it is."""
    print(text, file=sys.stderr, flush=True)


def environment(on_gpu, threads=1):
    """What herd and its peers are started with; GPUs are hidden from those that are not to use one."""
    hidden = {"CUDA_VISIBLE_DEVICES"} if on_gpu else set()
    settings = {name: value for name, value in ONE_THREAD.items() if name not in hidden}
    counts = {name: str(threads) for name in settings if name.endswith("_NUM_THREADS")}
    return {**os.environ, **settings, **counts}


class Bench:
    """One of herd's criterion benches, built once and run as often as there are rounds; `program` is one built before."""

    def __init__(self, package, bench, *features, program=None):
        self.home = ROOT / "target" / "peers" / f"{package}-{bench}"
        self.program = program
        if program:
            return
        command = ["cargo", "bench", "--locked", "-p", package, "--bench", bench, "--no-run"]
        command += ["--features", ",".join(features)] if features else []
        built = subprocess.run(
            [*command, "--message-format=json"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
        )
        messages = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
        self.program = next(
            m["executable"] for m in messages if m.get("executable") and m["target"]["name"] == bench
        )

    def run(self, only, seconds, samples=30, on_gpu=False, threads=1):
        """Microseconds an iteration, for every sample of every bench whose name contains `only`.

        With as many samples as iterations fit into `seconds`, each is of one iteration, as a peer's are.
        """
        subprocess.run(
            [self.program, "--bench", only, "--warm-up-time", "0.5", "--measurement-time", str(seconds),
             "--sample-size", str(max(int(samples), 10)), "--nresamples", "1001"],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**environment(on_gpu, threads), "CRITERION_HOME": str(self.home)},
        )  # fmt: skip
        found = {}
        for path in self.home.glob("**/new/benchmark.json"):
            name = json.loads(path.read_text(encoding="utf-8"))["full_id"]
            if only in name:
                sample = json.loads(path.with_name("sample.json").read_text(encoding="utf-8"))
                found[name] = [t / n / 1e3 for t, n in zip(sample["times"], sample["iters"], strict=True)]
        return found


class Peer:
    """A peer in its own process, idle between rounds: `program` answers each line of input with a line of JSON."""

    def __init__(self, *program, python=sys.executable, on_gpu=False):
        self.words = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")
        self.process = subprocess.Popen(
            [str(python), *map(str, program)], cwd=HERE, env=environment(on_gpu), text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.words,
        )  # fmt: skip
        self.ready = self.answer()

    def answer(self):
        """The next line of JSON; raises with the last words of a process that ended instead."""
        for line in self.process.stdout:
            if line.startswith("{"):
                found = json.loads(line)
                if "failed" in found:
                    raise RuntimeError(found["failed"])
                return found
        self.words.seek(0)
        raise RuntimeError((self.words.read().strip().splitlines() or ["ended without a word"])[-1])

    def run(self, seconds):
        """One round of about `seconds`."""
        self.process.stdin.write(f"{seconds}\n")
        self.process.stdin.flush()
        return self.answer()

    def close(self):
        """Ends the process."""
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.wait()
        self.words.close()


def refuse(why):
    """Ends a peer that cannot take part, with its reason for the table."""
    print(json.dumps({"failed": why}), flush=True)
    sys.exit(1)


def serve(work, **ready):
    """The other side of `Peer`: runs `work()` for as long as each line asks; answers with microseconds of each run."""
    import time

    print(json.dumps(ready), flush=True)
    for line in sys.stdin:
        end = time.perf_counter() + float(line)
        busy, begin, micros = time.process_time(), time.perf_counter(), []
        while (start := time.perf_counter()) < end:
            work()
            micros.append((time.perf_counter() - start) * 1e6)
        threads = (time.process_time() - busy) / (time.perf_counter() - begin)
        print(json.dumps({"micros": micros, "threads": threads}), flush=True)
