//! Writes a horizon as one quadratic programme in the stance forces alone.
//!
//! | symbol | name                                                              | unit  |
//! |--------|-------------------------------------------------------------------|-------|
//! | N, dt  | steps, length of one                                              | –, s  |
//! | Q, R   | weights of states and of u − u_ref                                | 1/unit² |
//! | M      | I⁻¹ skew(r) of a foot in a step                                   | rad/s² per N |
//! | T_l    | world angular velocity to angle rates in step l                   | –     |
//! | F_kj   | ∂Θ_k/∂(angular acceleration in step j)/dt = dt (½T_j + Σ_{j<l<k} T_l) | s  |
//!
//! The cost is Σ_{k=1..N} ‖x_k − ref_k‖²_Q + R Σ ‖u − u_ref‖², halved; u_ref shares the weight among the feet in
//! stance. Forces of feet in swing are left out, not bounded to zero, so the size follows the gait. The predicted state is
//! never formed as a dense power of matrices: position and velocity respond alike on each axis, and F_kj is a planar
//! scaled rotation beside a scalar, so every 3×3 block of H is M_aᵀ K_ij M_b plus a diagonal, with K_ij from two
//! sums, Σ_{k>j} Q F_kj and Σ_{k>j} F_kjᵀ Q F_kj (F_ki = F_kj + const for i < j). Later steps come first in u: rows of early
//! feet, which bind most often, then have short solutions of the triangular systems.

use super::Body;
use super::model::{GRAVITY, Linearised, State};
use super::qp::Qp;
use herd_common::config::control;
use nalgebra::{Matrix3, Vector3};

/// What is expected of one step of the horizon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Where the body should be at the end of the step.
    pub reference: State,
    /// World positions, m, of the feet in stance during the step; `None` swings.
    pub feet: [Option<Vector3<f64>>; 4],
}

impl Step {
    /// Feet in stance.
    pub fn stance(&self) -> usize {
        self.feet.iter().flatten().count()
    }
}

/// A planar scaled rotation [[a, b], [−b, a]] beside a scalar: the shape of T, of sums of T, and of F.
#[derive(Clone, Copy, Default)]
struct Turn {
    a: f64,
    b: f64,
    z: f64,
}

impl Turn {
    fn plus(self, other: Self, scale: f64) -> Self {
        Self { a: self.a + scale * other.a, b: self.b + scale * other.b, z: self.z + scale * other.z }
    }
}

/// A planar matrix [[xx, xy], [yx, yy]] beside a scalar.
#[derive(Clone, Copy, Default)]
struct Planar {
    xx: f64,
    xy: f64,
    yx: f64,
    yy: f64,
    z: f64,
}

impl Planar {
    /// `self · matrix`.
    fn times(&self, m: &Matrix3<f64>) -> Matrix3<f64> {
        let mut out = Matrix3::zeros();
        for c in 0..3 {
            out[(0, c)] = self.xx * m[(0, c)] + self.xy * m[(1, c)];
            out[(1, c)] = self.yx * m[(0, c)] + self.yy * m[(1, c)];
            out[(2, c)] = self.z * m[(2, c)];
        }
        out
    }
}

/// Sums over the states after step j of what a unit acceleration in step j does to them.
#[derive(Clone, Copy, Default)]
struct Tail {
    /// Σ Q F_kj, angles.
    first: Planar,
    /// Σ F_kjᵀ Q F_kj, angles; symmetric.
    second: Planar,
    /// Σ (k − j − ½) and Σ (k − j − ½)², for positions.
    moments: (f64, f64),
    /// Number of states after step j.
    count: f64,
}

/// One foot in one step.
#[derive(Clone, Copy)]
struct Slot {
    leg: usize,
    response: Matrix3<f64>,
}

/// One step, prepared.
struct Stage {
    model: Linearised,
    /// F_kj with the sum of T up to the step taken out: dt (½ T_j + Σ_{l<j} T_l).
    middle: Turn,
    tail: Tail,
    /// Feet in stance; the first `stance` of `slots` count.
    stance: usize,
    slots: [Slot; 4],
    /// Index in u of the first force of the step.
    first_variable: usize,
    /// u_z,ref, N.
    share_n: f64,
    /// Q (x_free − ref) at the end of the step.
    error: State,
}

/// Builds programmes for one body and one set of weights; keeps its buffers.
pub struct Condenser {
    config: control::Mpc,
    mass_kg: f64,
    inertia_inverse: Matrix3<f64>,
    stages: Vec<Stage>,
}

impl Condenser {
    /// For a body whose mass and inertia are positive.
    pub fn new(config: &control::Mpc, body: &Body) -> Self {
        assert!(body.mass_kg > 0.0, "mass is {} kg, expected a positive one", body.mass_kg);
        let factor = body.inertia.cholesky().expect("the inertia of a rigid body is positive definite");
        Self { config: config.clone(), mass_kg: body.mass_kg, inertia_inverse: factor.inverse(), stages: Vec::new() }
    }

    /// Where in u the force of `leg` in the first step begins; `None` in swing. Valid after `build`.
    pub fn first_step_force(&self, leg: usize) -> Option<usize> {
        let stage = self.stages.first()?;
        let slot = stage.slots[..stage.stance].iter().position(|slot| slot.leg == leg)?;
        Some(stage.first_variable + 3 * slot)
    }

    /// Writes the programme of `horizon` from `state` to `qp`.
    pub fn build(&mut self, state: &State, horizon: &[Step], qp: &mut Qp) {
        self.prepare(state, horizon);
        self.sum_tails();
        qp.resize(horizon.iter().map(Step::stance).sum());
        qp.friction = self.config.friction;
        qp.force_max_n = self.config.force_max_n;
        self.write_gradient(state, horizon, qp);
        for later in 0..self.stages.len() {
            for earlier in 0..=later {
                self.write_blocks(later, earlier, qp);
            }
        }
    }

    /// Linearises every step and lays out u.
    fn prepare(&mut self, state: &State, horizon: &[Step]) {
        let dt = self.config.step_secs;
        self.stages.clear();
        let mut start = *state;
        let mut sum = Turn::default();
        for step in horizon {
            let model = Linearised::between(&start, &step.reference, &self.inertia_inverse);
            let (a, b) = model.yaw_cos_sin;
            let turn = Turn { a, b, z: 1.0 };
            let mut slots = [Slot { leg: 0, response: Matrix3::zeros() }; 4];
            let mut stance = 0;
            for (leg, foot) in step.feet.iter().enumerate() {
                if let Some(foot) = foot {
                    slots[stance] = Slot { leg, response: model.angular_response(foot) };
                    stance += 1;
                }
            }
            self.stages.push(Stage {
                model,
                middle: sum.plus(turn, dt / 2.0),
                tail: Tail::default(),
                stance,
                slots,
                first_variable: 0,
                share_n: if stance == 0 { 0.0 } else { -GRAVITY.z * self.mass_kg / stance as f64 },
                error: State::zero(),
            });
            sum = sum.plus(turn, dt);
            start = step.reference;
        }
        let mut variable = 0;
        for stage in self.stages.iter_mut().rev() {
            stage.first_variable = variable;
            variable += 3 * stage.stance;
        }
    }

    /// Fills `tail` of every stage.
    fn sum_tails(&mut self) {
        let dt = self.config.step_secs;
        let [qx, qy, qz] = self.config.weight_angles;
        for j in 0..self.stages.len() {
            let mut tail = Tail::default();
            let middle = self.stages[j].middle;
            for k in j..self.stages.len() {
                // The sum of T up to the end of step k.
                let end = {
                    let stage = &self.stages[k];
                    let (a, b) = stage.model.yaw_cos_sin;
                    stage.middle.plus(Turn { a, b, z: 1.0 }, dt / 2.0)
                };
                let f = end.plus(middle, -1.0);
                tail.first.xx += qx * f.a;
                tail.first.xy += qx * f.b;
                tail.first.yx -= qy * f.b;
                tail.first.yy += qy * f.a;
                tail.first.z += qz * f.z;
                tail.second.xx += qx * f.a * f.a + qy * f.b * f.b;
                tail.second.xy += (qx - qy) * f.a * f.b;
                tail.second.yy += qx * f.b * f.b + qy * f.a * f.a;
                tail.second.z += qz * f.z * f.z;
                let age = (k - j) as f64 + 0.5;
                tail.moments.0 += age;
                tail.moments.1 += age * age;
                tail.count += 1.0;
            }
            tail.second.yx = tail.second.xy;
            self.stages[j].tail = tail;
        }
    }

    /// dt² times what an acceleration in `later` and one in `earlier` cost together, angular: K of the block.
    fn angular_coupling(&self, later: &Stage, earlier: &Stage) -> Planar {
        let dt = self.config.step_secs;
        let [wx, wy, wz] = self.config.weight_angular_velocity;
        let Tail { first, second, count, .. } = &later.tail;
        let shift = later.middle.plus(earlier.middle, -1.0);
        // second + firstᵀ · shift + count · Q_ω, with shift = [[a, b], [−b, a]] ⊕ z.
        Planar {
            xx: dt * dt * (second.xx + first.xx * shift.a - first.yx * shift.b + count * wx),
            xy: dt * dt * (second.xy + first.xx * shift.b + first.yx * shift.a),
            yx: dt * dt * (second.yx + first.xy * shift.a - first.yy * shift.b),
            yy: dt * dt * (second.yy + first.xy * shift.b + first.yy * shift.a + count * wy),
            z: dt * dt * (second.z + first.z * shift.z + count * wz),
        }
    }

    /// The same for linear accelerations, divided by m², on each axis.
    fn linear_coupling(&self, later: &Stage, steps_between: usize) -> [f64; 3] {
        let dt = self.config.step_secs;
        let (sum, sum_of_squares) = later.tail.moments;
        let positions = dt * dt * (sum_of_squares + steps_between as f64 * sum);
        let scale = dt * dt / (self.mass_kg * self.mass_kg);
        std::array::from_fn(|axis| {
            let (position, velocity) = (self.config.weight_position[axis], self.config.weight_velocity[axis]);
            scale * (position * positions + velocity * later.tail.count)
        })
    }

    /// Writes the blocks of H between the feet of two steps.
    fn write_blocks(&self, later: usize, earlier: usize, qp: &mut Qp) {
        let linear = self.linear_coupling(&self.stages[later], later - earlier);
        let (row_stage, column_stage) = (&self.stages[later], &self.stages[earlier]);
        let coupling = self.angular_coupling(row_stage, column_stage);
        let stride = qp.stride();
        for (n, column_slot) in column_stage.slots[..column_stage.stance].iter().enumerate() {
            let column = column_stage.first_variable + 3 * n;
            let moment = coupling.times(&column_slot.response);
            for (m, row_slot) in row_stage.slots[..row_stage.stance].iter().enumerate() {
                let row = row_stage.first_variable + 3 * m;
                let mut block = row_slot.response.tr_mul(&moment);
                let effort = if row == column { self.config.weight_force } else { 0.0 };
                for axis in 0..3 {
                    block[(axis, axis)] += linear[axis] + effort;
                }
                for i in 0..3 {
                    let entries = &mut qp.hessian[(row + i) * stride + column..][..3];
                    entries.copy_from_slice(&[block[(i, 0)], block[(i, 1)], block[(i, 2)]]);
                }
            }
        }
    }

    /// g = Γᵀ Q (x_free − ref) − R u_ref, by one pass forwards without forces and one backwards over the errors.
    fn write_gradient(&mut self, state: &State, horizon: &[Step], qp: &mut Qp) {
        self.weigh_free_motion(state, horizon);
        let dt = self.config.step_secs;
        let mut costate = State::zero();
        for stage in self.stages.iter().rev() {
            // costate: of the state at the end of this step.
            costate = State {
                angles: costate.angles + stage.error.angles,
                position: costate.position + stage.error.position,
                angular_velocity: costate.angular_velocity + stage.error.angular_velocity,
                velocity: costate.velocity + stage.error.velocity,
            };
            let turned = stage.model.angle_rates_transposed(&costate.angles);
            let angular = costate.angular_velocity * dt + turned * (dt * dt / 2.0);
            let linear = (costate.velocity * dt + costate.position * (dt * dt / 2.0)) / self.mass_kg;
            for (n, slot) in stage.slots[..stage.stance].iter().enumerate() {
                let mut gradient = slot.response.tr_mul(&angular) + linear;
                gradient.z -= self.config.weight_force * stage.share_n;
                let first = stage.first_variable + 3 * n;
                qp.gradient[first..first + 3].copy_from_slice(gradient.as_slice());
            }
            costate.angular_velocity += turned * dt;
            costate.velocity += costate.position * dt;
        }
    }

    /// Fills `error` of every stage with the weighted distance of free fall from the reference.
    fn weigh_free_motion(&mut self, state: &State, horizon: &[Step]) {
        let weigh = |weights: [f64; 3], error: Vector3<f64>| Vector3::from(weights).component_mul(&error);
        let mut free = *state;
        for (stage, step) in self.stages.iter_mut().zip(horizon) {
            free = stage.model.advance(&free, &Vector3::zeros(), &GRAVITY, self.config.step_secs);
            let reference = &step.reference;
            stage.error = State {
                angles: weigh(self.config.weight_angles, free.angles - reference.angles),
                position: weigh(self.config.weight_position, free.position - reference.position),
                angular_velocity: weigh(
                    self.config.weight_angular_velocity,
                    free.angular_velocity - reference.angular_velocity,
                ),
                velocity: weigh(self.config.weight_velocity, free.velocity - reference.velocity),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{self, ALL};
    use super::*;
    use proptest::prelude::*;

    /// The cost of eq 11 by walking through the horizon with these forces, in the order of u.
    fn rolled_out(state: &State, horizon: &[Step], forces: &[f64]) -> f64 {
        let config = testing::config();
        let body = testing::body();
        let weigh =
            |weights: [f64; 3], error: Vector3<f64>| Vector3::from(weights).component_mul(&error).dot(&error) / 2.0;
        let (mut cost, mut at, mut start) = (0.0, *state, *state);
        let mut end = forces.len();
        for step in horizon {
            let model = Linearised::between(&start, &step.reference, &testing::inertia_inverse());
            let mut next = end - 3 * step.stance();
            end = next;
            let (mut angular, mut linear) = (Vector3::zeros(), GRAVITY);
            for foot in step.feet.iter().flatten() {
                let force = Vector3::from_column_slice(&forces[next..next + 3]);
                next += 3;
                angular += testing::inertia_inverse_at(&start, &step.reference) * (foot - model.centre).cross(&force);
                linear += force / body.mass_kg;
                let share = -GRAVITY * body.mass_kg / step.stance() as f64;
                cost += config.weight_force * (force - share).norm_squared() / 2.0;
            }
            at = model.advance(&at, &angular, &linear, config.step_secs);
            let reference = &step.reference;
            cost += weigh(config.weight_angles, at.angles - reference.angles);
            cost += weigh(config.weight_position, at.position - reference.position);
            cost += weigh(config.weight_angular_velocity, at.angular_velocity - reference.angular_velocity);
            cost += weigh(config.weight_velocity, at.velocity - reference.velocity);
            start = step.reference;
        }
        cost
    }

    #[track_caller]
    fn check(stance: &[[bool; 4]], seed: u64, scale: f64) {
        let state = testing::disturbed(seed);
        let horizon = testing::horizon(stance, 0.7, seed);
        let qp = testing::programme(&state, &horizon);
        let forces: Vec<f64> =
            (0..qp.variables()).map(|i| scale * ((i * i) as f64 * 1.7 + seed as f64).sin()).collect();
        let zero = rolled_out(&state, &horizon, &vec![0.0; qp.variables()]);
        let got = qp.cost(&forces);
        let expected = rolled_out(&state, &horizon, &forces) - zero;
        assert!((got - expected).abs() < 1e-10 * (1.0 + expected.abs() + zero), "{got}, expected {expected}");
    }

    proptest! {
        #[test]
        fn the_cost_is_that_of_the_motion_it_stands_for(
            seed in 0_u64..1_000_000,
            scale in 0.1..200.0_f64,
            stance in prop::collection::vec(prop::array::uniform4(any::<bool>()), 1..14),
        ) {
            check(&stance, seed, scale);
        }
    }

    #[test]
    fn every_entry_of_the_hessian_is_the_mixed_difference_of_the_cost() {
        let state = testing::disturbed(5);
        let stance = [[true, false, false, true], ALL, [false; 4], [false, true, true, true]];
        let horizon = testing::horizon(&stance, -0.4, 5);
        let qp = testing::programme(&state, &horizon);
        let n = qp.variables();
        let cost = |at: &[(usize, f64)]| {
            let mut forces = vec![0.0; n];
            for (index, value) in at {
                forces[*index] += value;
            }
            rolled_out(&state, &horizon, &forces)
        };
        let zero = cost(&[]);
        for i in 0..n {
            let slope = (cost(&[(i, 1.0)]) - cost(&[(i, -1.0)])) / 2.0;
            assert!((slope - qp.gradient()[i]).abs() < 1e-11, "gradient {i}");
            for j in 0..n {
                let mixed = cost(&[(i, 10.0), (j, 10.0)]) - cost(&[(i, 10.0)]) - cost(&[(j, 10.0)]) + zero;
                assert!((mixed / 100.0 - qp.hessian(i, j)).abs() < 1e-12, "H[{i}, {j}]");
            }
        }
    }

    #[test]
    fn a_body_at_rest_on_its_reference_wants_its_weight_shared() {
        let mut horizon = testing::horizon(&[ALL; 10], 0.0, 3);
        let rest = State { position: Vector3::new(0.0, 0.0, 0.17), ..State::zero() };
        for step in &mut horizon {
            step.reference = rest;
            let corners = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)];
            step.feet = corners.map(|(x, y)| Some(Vector3::new(x, y, 0.0)));
        }
        let qp = testing::programme(&rest, &horizon);
        let share = testing::body().mass_kg * 9.81 / 4.0;
        for i in 0..qp.variables() {
            let slope: f64 = (0..qp.feet()).map(|foot| qp.hessian(i, 3 * foot + 2) * share).sum();
            assert!((slope + qp.gradient()[i]).abs() < 1e-12, "force {i}");
        }
    }
}
