"""The peers among QP solvers, each behind the same two calls: `prepare(problem)` untimed, `solve(prepared)` timed.

`solve` returns z and the seconds that the solver itself took: by its own clock, by the clock of our C++ shim, or None
where there is neither and the caller's clock has to do. All start cold, as herd's solver is measured.
"""

import ctypes
import importlib.util
import sys

import numpy as np

from bench import HERE, version
from qp_problems import one_sided

NATIVE = HERE / ".native"


def native_module(name):
    """The module of that name compiled for this very processor, beside the wheel's."""
    found = sorted(NATIVE.glob(f"{name}.*.so"))
    if not found:
        raise ImportError(f"{name} was not built from source (install.sh tells why)")
    specification = importlib.util.spec_from_file_location(name, found[0])
    module = importlib.util.module_from_spec(specification)
    # A C extension is one a process: the wheel's stays in `sys.modules`, ours does not enter.
    before = sys.modules.pop(name, None)
    specification.loader.exec_module(module)
    sys.modules.pop(name, None)
    if before is not None:
        sys.modules[name] = before
    return module


class Daqp:
    """DAQP, a dual active set (Arnström et al. 2022); its own clock of set-up and solve."""

    def __init__(self, native=False):
        import daqp

        self.module = native_module("daqp") if native else daqp
        self.name = "DAQP, -O3 -march=native" if native else "DAQP"
        self.how = f"{version('daqp')}, own clock"

    def prepare(self, p):
        return p.h, p.g, p.a, np.minimum(p.upper, 1e30), np.maximum(p.lower, -1e30)

    def solve(self, prepared):
        z, _, flag, info = self.module.solve(*prepared)
        assert flag == 1, f"exit flag {flag}"
        return z, info["setup_time"] + info["solve_time"]


class Quadprog:
    """Goldfarb–Idnani's dual active set; no clock of its own."""

    def __init__(self, native=False):
        import quadprog

        self.module = native_module("quadprog") if native else quadprog
        self.name = "quadprog, -O3 -march=native" if native else "quadprog"
        self.how = f"{version('quadprog')}, call less an empty call"

    def prepare(self, p):
        rows, bounds = one_sided(p)
        return p.h, -p.g, np.ascontiguousarray(rows.T), bounds

    def solve(self, prepared):
        return self.module.solve_qp(*prepared)[0], None


class QpOases:
    """qpOASES, a parametric active set; MPC options; through our shim."""

    def __init__(self):
        self.call = shim("qpoases")
        self.name, self.how = "qpOASES", f"{version('cmeel-qpoases')}, C++, MPC options"

    def prepare(self, p):
        z = np.empty(len(p.g))
        return [*p.a.shape[::-1], *map(pointer, (p.h, p.g, p.a, p.lower, p.upper, z))], z, p

    def solve(self, prepared):
        words, z, _ = prepared
        return z, checked(self.call(*words))


class Hpipm:
    """HPIPM, dense interior point on BLASFEO's AVX2 kernels; SPEED mode; through our shim."""

    def __init__(self, tolerance=1e-6):
        self.call, self.tolerance = shim("hpipm"), ctypes.c_double(tolerance)
        self.name, self.how = f"HPIPM {tolerance:.0e}", f"{version('comma-deps-acados')}, C, BLASFEO haswell"

    def prepare(self, p):
        z, columns = np.empty(len(p.g)), np.ascontiguousarray(p.a.T)
        masks = [np.isfinite(bound).astype(float) for bound in (p.lower, p.upper)]
        bounds = [np.where(np.isfinite(bound), bound, 0.0) for bound in (p.lower, p.upper)]
        kept = (p.h, p.g, columns, *bounds, *masks)
        return [*p.a.shape[::-1], *map(pointer, kept), self.tolerance, pointer(z)], z, kept

    def solve(self, prepared):
        words, z, _ = prepared
        return z, checked(self.call(*words))


class Piqp:
    """PIQP, dense proximal interior point; its own clock of set-up and solve."""

    def __init__(self, tolerance=1e-8):
        import piqp

        self.solver = piqp.DenseSolver()
        self.solver.settings.eps_abs = self.solver.settings.eps_rel = tolerance
        self.solver.settings.compute_timings = True
        self.name, self.how = f"PIQP {tolerance:.0e}", f"{version('piqp')}, own clock"

    def prepare(self, p):
        return np.asfortranarray(p.h), p.g, np.asfortranarray(p.a), p.lower, p.upper

    def solve(self, prepared):
        h, g, a, lower, upper = prepared
        self.solver.setup(h, g, None, None, a, lower, upper)
        self.solver.solve()
        info = self.solver.result.info
        return self.solver.result.x, info.setup_time + info.solve_time


class ProxQp:
    """ProxQP, dense augmented Lagrangian; its own clock of set-up and solve."""

    def __init__(self, tolerance=1e-5):
        import proxsuite

        self.dense, self.tolerance, self.solvers = proxsuite.proxqp.dense, tolerance, {}
        self.cold = proxsuite.proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        self.name, self.how = f"ProxQP {tolerance:.0e}", f"{version('proxsuite')}, own clock"

    def prepare(self, p):
        return np.asfortranarray(p.h), p.g, np.asfortranarray(p.a), np.maximum(p.lower, -1e20), p.upper

    def solve(self, prepared):
        h, g, a, lower, upper = prepared
        shape = a.shape
        if shape not in self.solvers:
            self.solvers[shape] = solver = self.dense.QP(shape[1], 0, shape[0])
            solver.settings.eps_abs, solver.settings.eps_rel = self.tolerance, 0.0
            solver.settings.compute_timings, solver.settings.initial_guess = True, self.cold
        solver = self.solvers[shape]
        solver.init(h, g, None, None, a, lower, upper)
        solver.solve()
        return solver.results.x, (solver.results.info.setup_time + solver.results.info.solve_time) * 1e-6


class Osqp:
    """OSQP, ADMM on sparse matrices; its own clock of set-up and solve."""

    def __init__(self, tolerance=1e-5):
        import osqp
        from scipy import sparse

        self.osqp, self.sparse, self.tolerance = osqp, sparse, tolerance
        self.name, self.how = f"OSQP {tolerance:.0e}", f"{version('osqp')}, own clock"

    def prepare(self, p):
        return dict(
            P=self.sparse.triu(self.sparse.csc_matrix(p.h), format="csc"), q=p.g, A=self.sparse.csc_matrix(p.a),
            l=np.maximum(p.lower, -1e30), u=p.upper,
        )  # fmt: skip

    def solve(self, prepared):
        solver = self.osqp.OSQP()
        solver.setup(**prepared, eps_abs=self.tolerance, eps_rel=self.tolerance, polishing=False,
                     verbose=False, max_iter=20000)  # fmt: skip
        result = solver.solve(raise_error=False)
        return result.x, result.info.setup_time + result.info.solve_time


class Clarabel:
    """Clarabel, sparse interior point, on the condensed programme; its own clock of the solve alone."""

    def __init__(self, tolerance=1e-8):
        import clarabel
        from scipy import sparse

        self.clarabel, self.sparse = clarabel, sparse
        self.settings = clarabel.DefaultSettings()
        self.settings.verbose = self.settings.presolve_enable = self.settings.iterative_refinement_enable = False
        self.settings.tol_gap_abs = self.settings.tol_gap_rel = self.settings.tol_feas = tolerance
        self.name, self.how = f"Clarabel {tolerance:.0e}", f"{version('clarabel')}, own clock, solve alone"

    def prepare(self, p):
        rows, bounds = one_sided(p)
        sparse = self.sparse
        cones = [self.clarabel.NonnegativeConeT(len(bounds))]
        return sparse.triu(sparse.csc_matrix(p.h), format="csc"), p.g, sparse.csc_matrix(-rows), -bounds, cones

    def solve(self, prepared):
        solution = self.clarabel.DefaultSolver(*prepared, self.settings).solve()
        return np.array(solution.x), solution.solve_time


def shim(name):
    """The function of `native/qp_shim.cpp` for one solver."""
    call = getattr(ctypes.CDLL(str(NATIVE / f"{name}_shim.so")), f"{name}_solve")
    call.restype = ctypes.c_double
    return call


def pointer(array):
    """A C array of doubles; the caller keeps the array alive."""
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def checked(seconds):
    """The shim's answer, whose sign is the solver's status."""
    assert seconds >= 0, "the solver gave up"
    return seconds


SOLVERS = [
    ("DAQP", Daqp),
    ("DAQP, native", lambda: Daqp(native=True)),
    ("quadprog", Quadprog),
    ("quadprog, native", lambda: Quadprog(native=True)),
    ("qpOASES", QpOases),
    ("HPIPM", Hpipm),
    ("PIQP", Piqp),
    ("ProxQP", ProxQp),
    ("ProxQP, tight", lambda: ProxQp(1e-8)),
    ("OSQP", Osqp),
    ("Clarabel", Clarabel),
]
