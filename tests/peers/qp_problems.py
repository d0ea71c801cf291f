"""Quadratic programmes to solve: herd's own from a dump, or made-up ones of their shape; and exact answers to them."""

import json
import os
import pathlib
import subprocess
from dataclasses import dataclass

import numpy as np

from bench import ROOT

STEPS, STEP_SECS, FRICTION, MASS_KG, FORCE_MAX_N = 10, 0.025, 0.6, 13.6, 200.0


@dataclass
class Problem:
    """Minimise ½ zᵀHz + gᵀz subject to lower ≤ Az ≤ upper."""

    h: np.ndarray
    g: np.ndarray
    a: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    # Where in z the force of the first step begins, and how many feet bear it.
    first: int = 0
    first_feet: int = 2
    herd: np.ndarray | None = None
    herd_build_us: float | None = None
    herd_solve_us: float | None = None

    def first_error(self, z, exact):
        """Largest error of a component of the first step's forces, N: what the robot feels."""
        span = slice(self.first, self.first + 3 * self.first_feet)
        return float(np.max(np.abs(np.asarray(z)[span] - exact[span])))


def dump(directory, count, program=None):
    """Has herd write `count` of its programmes, with its own times, to `directory`."""
    if program is None:
        build = ["cargo", "run", "--quiet", "--locked", "--release"]
        example = [*build, "-p", "herd-actor", "--example", "dump_qps", "--"]
    else:
        example = [str(program)]
    subprocess.run([*example, str(directory), str(count)], cwd=ROOT, check=True, env=dict(os.environ))


def read(directory):
    """The programmes of a dump."""
    directory = pathlib.Path(directory)
    numbers = np.fromfile(directory / "qps.f64", dtype="<f8")
    problems = []
    for q in json.loads((directory / "qps.json").read_text(encoding="utf-8")):
        n, m = q["n"], q["m"]

        def block(key, *shape, q=q):
            begin = q["offset_" + key]
            return np.ascontiguousarray(numbers[begin : begin + int(np.prod(shape))].reshape(shape))

        problems.append(
            Problem(
                block("h", n, n), block("g", n), block("a", m, n), block("lower", m), block("upper", m),
                q.get("first_step", 0), max(q["feet_per_step"][0], 1), block("u", n),
                q["herd_build_us"], q["herd_solve_us"],
            )  # fmt: skip
        )
    return problems


def cross(v):
    """The matrix of v × ·."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def synthetic(count, seed=1):
    """Condensed convex MPC of a disturbed trot (Di Carlo et al. 2018): 60 variables, 100 rows."""
    rng = np.random.default_rng(seed)
    return [one(rng) for _ in range(count)]


def one(rng):
    """One such programme; states are angles, position, rates, velocity, and the pull of gravity."""
    inertia = np.diag([0.040, 0.082, 0.088])
    state = np.concatenate([rng.uniform(-1, 1, 3) * 0.1, [0, 0, 0.17], rng.uniform(-1, 1, 3) * 0.8,
                            rng.uniform(-1, 1, 3) * 0.3 + [0.5, 0, 0], [-9.81]])  # fmt: skip
    step = np.eye(13)
    step[0:3, 6:9] = step[3:6, 9:12] = np.eye(3) * STEP_SECS
    step[11, 12] = STEP_SECS
    corners = np.array([(0.07, 0.09, -0.17), (0.07, -0.09, -0.17), (-0.07, 0.09, -0.17), (-0.07, -0.09, -0.17)])
    feet = corners + rng.uniform(-1, 1, (4, 3)) * [0.03, 0.03, 0.003]
    free, forced = np.zeros((13 * STEPS, 13)), np.zeros((13 * STEPS, 6 * STEPS))
    for k in range(STEPS):
        stance = (0, 3) if k < STEPS // 2 else (1, 2)
        push = np.zeros((13, 6))
        for i, leg in enumerate(stance):
            push[6:9, 3 * i : 3 * i + 3] = np.linalg.inv(inertia) @ cross(feet[leg]) * STEP_SECS
            push[9:12, 3 * i : 3 * i + 3] = np.eye(3) * STEP_SECS / MASS_KG
        rows, before = slice(13 * k, 13 * k + 13), slice(13 * k - 13, 13 * k)
        free[rows] = step if k == 0 else step @ free[before]
        if k:
            forced[rows] = step @ forced[before]
        forced[rows, 6 * k : 6 * k + 6] = push
    weights = np.tile([25, 25, 10, 10, 10, 100, 0.3, 0.3, 0.6, 1, 1, 0.3, 0], STEPS)
    wanted = np.concatenate([[0, 0, 0, 0.5 * (k + 1) * STEP_SECS, 0, 0.17, 0, 0, 0, 0.5, 0, 0, -9.81]
                             for k in range(STEPS)])  # fmt: skip
    h = 2 * (forced.T * weights @ forced + 1e-5 * np.eye(6 * STEPS))
    g = 2 * forced.T @ (weights * (free @ state - wanted))
    cone = np.array([(1, 0, -FRICTION), (-1, 0, -FRICTION), (0, 1, -FRICTION), (0, -1, -FRICTION), (0, 0, 1)])
    bounds = np.tile([0, 0, 0, 0, FORCE_MAX_N], 2 * STEPS)
    return Problem((h + h.T) / 2, g, np.kron(np.eye(2 * STEPS), cone), np.full(10 * STEPS, -np.inf), bounds)


def exact(problem, quadprog):
    """The minimiser to rounding: the active set of Goldfarb–Idnani, its KKT system refined in long double.

    Raises if the result is not the minimiser: a row violated or a multiplier of the wrong sign.
    """
    rows, bounds = one_sided(problem)
    found = quadprog.solve_qp(problem.h, -problem.g, np.ascontiguousarray(rows.T), bounds)
    active = found[5][found[5] > 0] - 1
    n, k = len(problem.g), len(active)
    kkt = np.zeros((n + k, n + k))
    kkt[:n, :n] = problem.h
    kkt[:n, n:], kkt[n:, :n] = -rows[active].T, rows[active]
    right = np.concatenate([-problem.g, bounds[active]])
    wide, solution = kkt.astype(np.longdouble), np.linalg.solve(kkt, right).astype(np.longdouble)
    for _ in range(4):
        solution += np.linalg.solve(kkt, (right - wide @ solution).astype(float))
    z, multipliers = solution[:n].astype(float), solution[n:].astype(float)
    assert np.min(rows @ z - bounds) > -1e-7, "the reference violates a row"
    slack = 1e-7 * max(1.0, np.max(np.abs(problem.g)))
    assert k == 0 or np.min(multipliers) > -slack, "a multiplier of the reference has the wrong sign"
    return z


def one_sided(problem):
    """The same rows as `rows z ≥ bounds`, without those that bound nothing."""
    above, below = np.isfinite(problem.lower), np.isfinite(problem.upper)
    rows = np.concatenate([problem.a[above], -problem.a[below]])
    return rows, np.concatenate([problem.lower[above], -problem.upper[below]])
