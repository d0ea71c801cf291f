//! Writes the quadratic programmes of a pushed, policy-driven run to files, for comparisons with other solvers.
//!
//! `cargo run --release -p herd-actor --example dump_qps -- DIRECTORY [COUNT] [POLICY.safetensors]`
//!
//! A programme is: minimise ½ uᵀHu + gᵀu subject to lower ≤ A u ≤ upper, exactly as our solver gets it. `qps.f64` holds
//! little-endian f64, matrices row-major, one programme after the other: H \[n·n\], g \[n\], A \[m·n\], lower \[m\] (−∞
//! throughout), upper \[m\], u \[n\] (our minimiser). `qps.json` is a list of objects, one per programme:
//!
//! | key | meaning |
//! |-----|---------|
//! | `n`, `m` | variables, rows; m = 5 n / 3: per foot ±u_x − μ u_z ≤ 0, ±u_y − μ u_z ≤ 0, u_z ≤ limit |
//! | `feet_per_step` | feet in stance in each step of the horizon, first step first |
//! | `first_step` | index in u of the first force of the first step; later steps come first in u |
//! | `offset_h`, `offset_g`, `offset_a`, `offset_lower`, `offset_upper`, `offset_u` | where each begins, in f64 from the start of the file |
//! | `herd_build_us`, `herd_solve_us` | medians over repeats, µs: state and horizon to H and g; H and g to u |
//! | `herd_iterations` | iterations of our solver |

use anyhow::Context;
use herd_actor::mpc::{ActiveSet, Body, Condenser, Qp, QpSolver, Step};
use herd_actor::robot::Model;
use herd_actor::trial::{self, Question};
use herd_common::config::Config;
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use std::fmt::Write as _;
use std::hint::black_box;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

/// Every so manieth question is written: neighbours in time are much alike.
const STRIDE: usize = 3;
/// Measurements per programme, of which the median is told.
const REPEATS: usize = 21;

#[expect(clippy::print_stdout, reason = "a summary for people")]
fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let directory = PathBuf::from(arguments.next().context("usage: dump_qps DIRECTORY [COUNT] [POLICY.safetensors]")?);
    let count = arguments.next().map_or(Ok(1000), |count| count.parse()).context("read COUNT")?;
    let config = Config::default();
    let policy = match arguments.next() {
        Some(path) => Policy::from_safetensors(&std::fs::read(&path).with_context(|| format!("read {path}"))?)?,
        None => trial::erratic_policy(&config, Seed::from_number(1)),
    };
    let composite = Model::new(&config.robot);
    let composite = composite.composite(&composite.nominal_stance());
    let body = Body { mass_kg: composite.mass, inertia: composite.inertia };
    let mut condenser = Condenser::new(&config.control.mpc, &body);
    std::fs::create_dir_all(&directory).with_context(|| format!("create {}", directory.display()))?;
    let mut numbers = Numbers { file: std::io::BufWriter::new(create(&directory, "qps.f64")?), written: 0 };
    let (mut objects, mut totals) = (Vec::new(), Vec::new());
    let mut solver = ActiveSet::default();
    for question in trial::questions(&config, &policy, count, STRIDE) {
        let dumped = measure(&mut condenser, &mut solver, &question)?;
        totals.push(dumped.build_micros + dumped.solve_micros);
        objects.push(dump(&dumped, &question, &condenser, &mut numbers)?);
    }
    numbers.file.flush()?;
    write!(create(&directory, "qps.json")?, "[\n{}\n]\n", objects.join(",\n"))?;
    let (median, most) = (quantile(&mut totals, 0.5), quantile(&mut totals, 0.99));
    println!("{} programmes, build + solve: median {median:.1} µs, p99 {most:.1} µs", objects.len());
    Ok(())
}

fn create(directory: &std::path::Path, name: &str) -> anyhow::Result<std::fs::File> {
    let path = directory.join(name);
    std::fs::File::create(&path).with_context(|| format!("create {}", path.display()))
}

/// A programme with our answer and what it took.
struct Solved {
    qp: Qp,
    forces: Vec<f64>,
    iterations: u32,
    build_micros: f64,
    solve_micros: f64,
}

fn measure(condenser: &mut Condenser, solver: &mut ActiveSet, question: &Question) -> anyhow::Result<Solved> {
    let mut solved =
        Solved { qp: Qp::default(), forces: Vec::new(), iterations: 0, build_micros: 0.0, solve_micros: 0.0 };
    let (mut build, mut solve) = (Vec::new(), Vec::new());
    for _ in 0..REPEATS {
        build.push(
            micros(|| condenser.build(black_box(&question.state), black_box(&question.horizon), &mut solved.qp)).0,
        );
        solved.forces.resize(solved.qp.variables(), 0.0);
        let (time, iterations) = micros(|| solver.solve(black_box(&solved.qp), &mut solved.forces));
        solved.iterations = iterations?;
        solve.push(time);
    }
    (solved.build_micros, solved.solve_micros) = (quantile(&mut build, 0.5), quantile(&mut solve, 0.5));
    Ok(solved)
}

/// How long `work` takes, µs, with its result.
#[expect(clippy::disallowed_methods, reason = "this program measures time")]
fn micros<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let begin = Instant::now();
    let result = work();
    (begin.elapsed().as_nanos() as f64 / 1e3, result)
}

/// The value that this share of all stays below; 0 of none.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (share * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or_default()
}

/// The file of numbers and how many it holds.
struct Numbers {
    file: std::io::BufWriter<std::fs::File>,
    written: usize,
}

impl Numbers {
    /// Writes a block; returns where it begins.
    fn put(&mut self, block: impl IntoIterator<Item = f64>) -> std::io::Result<usize> {
        let begin = self.written;
        for number in block {
            self.file.write_all(&number.to_le_bytes())?;
            self.written += 1;
        }
        Ok(begin)
    }
}

/// Writes the numbers of one programme; returns its object for the list.
fn dump(solved: &Solved, question: &Question, condenser: &Condenser, numbers: &mut Numbers) -> anyhow::Result<String> {
    let qp = &solved.qp;
    let (n, m) = (qp.variables(), qp.rows());
    let row = |index: usize| {
        let mut dense = vec![0.0; n];
        for (variable, coefficient) in qp.row(index).terms {
            dense[variable] += coefficient;
        }
        dense
    };
    let feet: Vec<usize> = question.horizon.iter().map(Step::stance).collect();
    let first_step = (0..4).find_map(|leg| condenser.first_step_force(leg));
    let mut object = format!("{{\"n\": {n}, \"m\": {m}, \"feet_per_step\": {feet:?}");
    if let Some(first_step) = first_step {
        write!(object, ", \"first_step\": {first_step}")?;
    }
    for (key, offset) in [
        ("h", numbers.put((0..n * n).map(|index| qp.hessian(index / n, index % n)))?),
        ("g", numbers.put(qp.gradient().iter().copied())?),
        ("a", numbers.put((0..m).flat_map(row))?),
        ("lower", numbers.put((0..m).map(|_| f64::NEG_INFINITY))?),
        ("upper", numbers.put((0..m).map(|index| qp.row(index).bound))?),
        ("u", numbers.put(solved.forces.iter().copied())?),
    ] {
        write!(object, ", \"offset_{key}\": {offset}")?;
    }
    let Solved { build_micros, solve_micros, iterations, .. } = solved;
    write!(object, ", \"herd_build_us\": {build_micros:.3}, \"herd_solve_us\": {solve_micros:.3}")?;
    write!(object, ", \"herd_iterations\": {iterations}}}")?;
    Ok(object)
}
