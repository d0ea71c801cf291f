"""Solves herd's quadratic programmes with other solvers: µs of the solver alone, error of the first force, the ratio.

Every programme is solved several times in a row and counts with its median, by herd and by its peers alike; medians and
p99 are over programmes. Each round runs herd's dump and then every peer, so that drift of the machine hits all.
"""

import pathlib
import tempfile
import time

import numpy as np

import bench
import qp_problems
import qp_solvers

WORK = "MPC QP"


class Contender:
    """A solver and what it has shown so far."""

    def __init__(self, solver):
        self.solver = solver
        self.alone, self.called, self.errors = [], [], []
        self.overhead = self.empty_call()

    def empty_call(self):
        """Seconds of a call with one variable and one row: the wrapper's cost."""
        tiny = qp_problems.Problem(np.eye(1), np.ones(1), np.ones((1, 1)), -np.ones(1) * np.inf, np.ones(1))
        prepared = self.solver.prepare(tiny)
        return min(self.timed(prepared)[1] for _ in range(100))

    def timed(self, prepared):
        """z, seconds by our clock, seconds by the solver's (ours less an empty call where it has none)."""
        start = time.perf_counter()
        z, own = self.solver.solve(prepared)
        called = time.perf_counter() - start
        return z, called, own if own is not None else called - getattr(self, "overhead", 0.0)

    def meet(self, problem, exact, repeats):
        """Solves one programme `repeats` times in a row."""
        prepared = self.solver.prepare(problem)
        runs = [self.timed(prepared) for _ in range(repeats)]
        self.called.append(bench.quantile([called for _, called, _ in runs], 0.5) * 1e6)
        self.alone.append(bench.quantile([own for _, _, own in runs], 0.5) * 1e6)
        self.errors.append(problem.first_error(runs[-1][0], exact))

    def row(self):
        """Its line of the table."""
        call = bench.quantile(self.called, 0.5) - bench.quantile(self.alone, 0.5)
        note = f"{self.solver.how}; first force within {max(self.errors):.0e} N; call adds {call:.0f} µs"
        return bench.row(WORK, self.solver.name, "µs", self.alone, note)


def contenders(rows):
    """All solvers that are installed; the others get a row that says why not."""
    found = []
    for name, make in qp_solvers.SOLVERS:
        try:
            found.append(Contender(make()))
        except Exception as error:  # noqa: BLE001 - whatever keeps a peer away is told in the table
            rows.append(bench.failed(WORK, name, error))
    return found


def dumped(options, count):
    """Herd's programmes with its times in this round."""
    if options.dump:
        return qp_problems.read(options.dump)
    with tempfile.TemporaryDirectory() as directory:
        qp_problems.dump(directory, count, options.dump_program)
        return qp_problems.read(directory)


def round_of(problems, exacts, solvers, repeats, rows):
    """Every solver solves every programme; one that fails once is out."""
    for contender in list(solvers):
        try:
            for problem, exact in zip(problems, exacts, strict=True):
                contender.meet(problem, exact, repeats)
        except Exception as error:  # noqa: BLE001
            solvers.remove(contender)
            rows.append(bench.failed(WORK, contender.solver.name, error))


def measure(options):
    """The rows of the table."""
    import quadprog

    count, repeats = (30, 5) if options.quick else (options.count, 21)
    rows, solve, build, errors = [], [], [], []
    solvers = contenders(rows)
    for number in range(1 if options.quick else options.rounds):
        bench.say(f"qp: round {number + 1}")
        problems = qp_problems.synthetic(count) if options.no_herd and not options.dump else dumped(options, count)
        exacts = [qp_problems.exact(problem, quadprog) for problem in problems]
        herd = [problem for problem in problems if problem.herd is not None]
        solve += [problem.herd_solve_us for problem in herd]
        build += [problem.herd_build_us for problem in herd]
        errors += [p.first_error(p.herd, e) for p, e in zip(problems, exacts, strict=True) if p.herd is not None]
        round_of(problems, exacts, solvers, repeats, rows)
    peers = [contender.row() for contender in solvers]
    if solve:
        shapes = sorted({problem.a.shape[::-1] for problem in problems})
        note = f"{len(problems)} programmes of {shapes[0]} to {shapes[-1]}; first force within {max(errors):.0e} N"
        peers.insert(0, bench.row(WORK, "herd", "µs", solve, note))
        peers.append(bench.row(f"{WORK}, building it", "herd", "µs", build, "state and horizon to H and g"))
    return peers + rows


def main():
    options = bench.arguments(
        __doc__,
        dump={"type": pathlib.Path, "help": "read this dump, made by herd's example dump_qps, instead of making one"},
        dump_program={"type": pathlib.Path, "help": "herd's example dump_qps, already built"},
        count={"type": int, "default": 200, "help": "programmes a round (default 200)"},
        rounds={"type": int, "default": 3, "help": "rounds of herd and all peers (default 3)"},
    )
    bench.report(measure(options), options)


if __name__ == "__main__":
    main()
