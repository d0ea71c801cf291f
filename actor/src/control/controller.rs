//! The controller: takes a gait for one swing, then a torque for every joint at every tick.
//!
//! A gait is what is wanted; what a body and legs cannot do is cut here, so that no gait throws the robot over by itself.
//! With v* the speed aimed at and v the faster of it and the measured one: v* follows `v_x`, kept between two speeds, with
//! bounded acceleration and near the speed that the robot has; Δt is at most the longest stride over v, and S shrinks with
//! it; H is at least proportional to v; a foot advances in the first `1 − c v²` of its swing, 0.87 at least, and then only
//! sinks, since one that lands while it advances skids and brakes; a foot that stands is held where it is. Lateral velocity
//! and yaw rate are taken as they are asked for.
//!
//! The MPC is asked every `period_secs`, and at once when legs change their duty, so that no force is held by a leg
//! that left the ground. Its answer is used in the tick that asked: there is no delay.

use super::contact::{self, Duty};
use super::latency::Latency;
use super::leg::Body;
use super::reference::Reference;
use super::stance::Outlook;
use super::steering::Steering;
use super::terrain::Terrain;
use crate::gait::{Motion, Pair, Planner, Schedule, Swing};
use crate::mpc::{self, Mpc, Status};
use crate::robot::{Leg, Model};
use crate::sim::Contacts;
use herd_common::config::{Config, control, task};
use herd_common::episode::Counts;
use nalgebra::{Vector2, Vector3};

/// Least share of a swing in which the foot advances.
const SHORTEST_ADVANCE: f64 = 0.87;
/// Distance from the centre at which a turn counts as speed, about that of a foot, m.
const HALT_ARM_M: f64 = 0.15;

/// Nanoseconds since any fixed moment; only differences count, and only for telemetry.
pub type Timer = fn() -> u64;

/// Sees every question that the controller puts to its MPC.
pub type Watcher = Box<dyn FnMut(&mpc::State, &[mpc::Step]) + Send>;

/// Drives one robot.
pub struct Controller {
    config: control::Config,
    tick_secs: f64,
    planner: Planner,
    mpc: Mpc,
    /// Height of the centre of mass in the nominal stance, m.
    height: f64,
    torque_max: f64,
    gait: task::Constant,
    /// v*: the speed asked for, as far as bounded acceleration has come, m/s.
    pace: f64,
    steering: Steering,
    schedule: Schedule,
    duties: [Duty; 4],
    forces: [Vector3<f64>; 4],
    reference: Option<Reference>,
    terrain: Terrain,
    ticks_to_solve: u32,
    counts: Counts,
    timer: Option<Timer>,
    watcher: Option<Watcher>,
    latency: Latency,
}

impl Controller {
    /// A controller for this robot.
    pub fn new(config: &Config, model: &Model) -> Self {
        let composite = model.composite(&model.nominal_stance());
        let body = mpc::Body { mass_kg: composite.mass, inertia: composite.inertia };
        let tick_secs = config.sim.tick_secs;
        let height = model.standing_height() + composite.centre.z;
        Self {
            planner: Planner::new(model.geometry, model.foot_radius, height, &config.control.gait),
            mpc: Mpc::new(&config.control.mpc, body),
            height,
            torque_max: model.torque_max,
            gait: config.task.constant,
            pace: 0.0,
            steering: Steering::default(),
            schedule: first_schedule(tick_secs),
            duties: [Duty::Stands; 4],
            forces: [Vector3::zeros(); 4],
            reference: None,
            terrain: Terrain::level(),
            ticks_to_solve: 0,
            counts: Counts::default(),
            timer: None,
            watcher: None,
            latency: Latency::default(),
            config: config.control.clone(),
            tick_secs,
        }
    }

    /// Measures the solver with this timer from now on.
    pub fn set_timer(&mut self, timer: Timer) {
        self.timer = Some(timer);
    }

    /// Shows this watcher every solve from now on.
    pub fn set_watcher(&mut self, watcher: Watcher) {
        self.watcher = Some(watcher);
    }

    /// How long the solver took, since the controller was made.
    pub fn latency(&self) -> &Latency {
        &self.latency
    }

    /// What was counted since the last reset.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// The pair that swings next.
    pub fn next_pair(&self) -> Pair {
        self.schedule.swinging().other()
    }

    /// Forgets everything: all legs stand, FL + RR swing first.
    pub fn reset(&mut self) {
        self.schedule = first_schedule(self.tick_secs);
        self.duties = [Duty::Stands; 4];
        self.forces = [Vector3::zeros(); 4];
        self.pace = 0.0;
        self.reference = None;
        self.terrain = Terrain::level();
        self.steering = Steering::default();
        self.counts = Counts::default();
    }

    /// Asks for a velocity to the left (m/s) and a yaw rate (rad/s) beside the gait's forward velocity, until told anew.
    pub fn steer(&mut self, lateral_mps: f64, yaw_radps: f64) {
        self.steering = Steering { lateral_mps, yaw_radps, ..self.steering };
    }

    /// Where the robot is meant to head: all yaw rates asked for since the reset, full turns included, rad.
    pub fn heading(&self) -> f64 {
        self.steering.heading
    }

    /// Where the robot is meant to be, world, m; nowhere before the first tick.
    pub fn place(&self) -> Option<Vector2<f64>> {
        self.reference.map(|reference| reference.position())
    }

    /// Height of the ground below a point as the feet feel it, world, m; unknown before the first tick.
    pub fn ground_below(&self, place: &Vector2<f64>) -> Option<f64> {
        self.terrain.is_felt().then(|| self.terrain.height(place))
    }

    /// Begins a swing with this gait; returns how many ticks it lasts.
    pub fn begin(&mut self, gait: &task::Constant, body: &Body<'_>) -> u32 {
        if self.may_halt(gait, body) {
            return self.halt(gait, body);
        }
        // A leg reaches no further than its longest stride: a fast robot steps sooner than it was asked to.
        let speed = body.centre_velocity().xy().norm().max(self.pace.abs());
        let step_secs = gait.step_secs.min(self.config.gait.stride_max_m / speed.max(1e-3));
        self.schedule = Schedule::new(self.next_pair(), step_secs, self.tick_secs);
        let [backwards, forwards] = self.config.gait.speed_mps;
        // The stride shrinks with the time that it has: what fits the speed goes on to fit it.
        let stride_m = gait.stride_m * step_secs / gait.step_secs;
        self.gait = task::Constant { velocity_mps: gait.velocity_mps.clamp(backwards, forwards), stride_m, ..*gait };
        for leg in Leg::ALL {
            let duty = &mut self.duties[leg.index()];
            if self.schedule.swings(leg) {
                let swing = Swing {
                    from: body.foot(leg),
                    lift: gait.lift_m.max(self.config.gait.lift_per_speed_secs * speed),
                    duration: self.schedule.duration_secs(),
                    advance_share: (1.0 - self.config.swing.sink_share * speed.powi(2)).max(SHORTEST_ADVANCE),
                };
                *duty = Duty::Flies { swing, ticks: 0, target: swing.from };
            } else if !duty.stands() {
                self.counts.late_contacts += 1;
            }
        }
        self.ticks_to_solve = 0;
        self.schedule.duration_ticks()
    }

    /// True when nothing but standing is asked for and the robot is slow enough to stop on the feet that it has.
    fn may_halt(&self, gait: &task::Constant, body: &Body<'_>) -> bool {
        let (speed, turn) = (body.centre_velocity().xy().norm(), body.state.angular_velocity.z.abs());
        let slow = speed < self.config.gait.halt_mps && turn * HALT_ARM_M < self.config.gait.halt_mps;
        gait.velocity_mps == 0.0 && self.steering.is_straight() && slow
    }

    /// Stands on all legs for the time of a swing, in the middle of the feet as they are when it stops.
    fn halt(&mut self, gait: &task::Constant, body: &Body<'_>) -> u32 {
        if !self.schedule.is_halted() {
            let middle = Leg::ALL.into_iter().map(|leg| body.foot(leg).xy()).sum::<Vector2<f64>>() / 4.0;
            self.reference = Some(Reference::new(middle));
        }
        self.schedule = self.schedule.halt(gait.step_secs);
        self.gait = *gait;
        self.pace = 0.0;
        self.ticks_to_solve = 0;
        self.schedule.duration_ticks()
    }

    /// Torques (N·m) for the next tick, from the state after the last one.
    pub fn torques(&mut self, body: &Body<'_>, contacts: &Contacts) -> [Vector3<f64>; 4] {
        self.terrain.feel(body, &self.duties, contacts, self.tick_secs);
        let motion = self.motion(body);
        self.aim(&motion);
        if contact::notice(&mut self.duties, &self.schedule, contacts, &self.config.swing, &mut self.counts) {
            self.ticks_to_solve = 0;
        }
        if self.ticks_to_solve == 0 {
            self.solve(body, motion);
            self.ticks_to_solve = ((self.config.mpc.period_secs / self.tick_secs).round() as u32).max(1);
        }
        self.ticks_to_solve -= 1;
        let torques = Leg::ALL.map(|leg| self.leg_torques(leg, body, contacts.feet[leg.index()]));
        self.advance(&motion);
        torques.map(|leg| leg.map(|torque| self.within_limit(torque)))
    }

    fn motion(&self, body: &Body<'_>) -> Motion {
        Motion {
            position: body.centre().xy(),
            velocity: body.centre_velocity().xy(),
            wanted: self.steering.world(self.pace),
            turn: self.steering.yaw_radps,
            yaw: body.state.angles().z,
            yaw_rate: body.state.angular_velocity.z,
        }
    }

    /// Plans the footholds of the legs in the air anew.
    fn aim(&mut self, motion: &Motion) {
        if self.schedule.elapsed_ticks() > 0 && self.schedule.phase() > self.config.swing.aim_share {
            return;
        }
        let (stance_secs, remaining) = (self.schedule.duration_secs(), self.schedule.remaining_secs());
        for leg in Leg::ALL {
            if let Duty::Flies { target, .. } = &mut self.duties[leg.index()]
                && self.schedule.swings(leg)
            {
                *target = self.planner.foothold(leg, motion, self.gait.stride_m, stance_secs, remaining);
                target.z += self.terrain.height(&target.xy());
            }
        }
    }

    fn solve(&mut self, body: &Body<'_>, motion: Motion) {
        let lead = self.reference.map_or(Vector2::zeros(), |reference| reference.position() - motion.position);
        let outlook = Outlook {
            body,
            duties: &self.duties,
            schedule: &self.schedule,
            planner: &self.planner,
            motion,
            stride: self.gait.stride_m,
            target: motion.wanted + lead * self.config.gait.position_gain,
            acceleration: self.config.gait.acceleration_mps2,
            heading: self.steering.heading,
            height: self.height,
            terrain: &self.terrain,
        };
        let (state, horizon) = (outlook.state(), outlook.horizon(&self.config.mpc));
        if let Some(watcher) = &mut self.watcher {
            watcher(&state, &horizon);
        }
        let begin = self.timer.map(|timer| timer());
        let solution = self.mpc.solve(&state, &horizon);
        if let (Some(timer), Some(begin)) = (self.timer, begin) {
            self.latency.record(timer().saturating_sub(begin));
        }
        self.counts.qp_solves += 1;
        self.counts.qp_failures += u64::from(solution.status != Status::Solved);
        self.forces = solution.forces;
    }

    fn leg_torques(&self, leg: Leg, body: &Body<'_>, touches: bool) -> Vector3<f64> {
        match &self.duties[leg.index()] {
            Duty::Stands => {
                // A foot that bears little would be dragged along by its hip, ever further from where it was put.
                let down = if touches { 0.0 } else { self.config.swing.reach_down_mps };
                let still = Vector3::new(0.0, 0.0, -down);
                let grip = body.grip_torques(leg, &still, self.config.swing.grip_nspm);
                body.stance_torques(leg, &self.forces[leg.index()]) + grip
            }
            Duty::Flies { swing, ticks, target } => {
                let elapsed = f64::from(*ticks) * self.tick_secs;
                let below = Vector3::z() * self.config.gait.touchdown_depth_m;
                let mut path = swing.at(elapsed, &(target - below));
                let late = elapsed - swing.duration;
                if late > 0.0 {
                    path.position.z -= self.config.swing.reach_down_mps * late;
                    path.velocity.z = -self.config.swing.reach_down_mps;
                }
                body.swing_torques(leg, &path, &self.config.swing)
            }
        }
    }

    fn advance(&mut self, motion: &Motion) {
        let (most, lead) = (self.config.gait.pace_mps2 * self.tick_secs, self.config.gait.pace_lead_mps);
        let ahead = self.steering.ahead(&motion.velocity);
        self.pace += (self.gait.velocity_mps - self.pace).clamp(-most, most);
        // What friction cannot do yet is not asked for: feet set out for it would land beyond what can bear the trunk.
        self.pace = self.pace.max(ahead - lead).min(ahead + lead);
        let here = motion.position;
        let bound = self.config.gait.position_clamp_m;
        self.reference.get_or_insert(Reference::new(here)).advance(&motion.wanted, self.tick_secs, &here, bound);
        self.steering.advance(self.tick_secs);
        self.schedule.tick();
        for duty in &mut self.duties {
            if let Duty::Flies { ticks, .. } = duty {
                *ticks += 1;
            }
        }
    }

    fn within_limit(&mut self, torque: f64) -> f64 {
        self.counts.saturated_torques += u64::from(torque.abs() > self.torque_max);
        torque.clamp(-self.torque_max, self.torque_max)
    }
}

/// The schedule before the first swing: the next pair is FL + RR.
fn first_schedule(tick_secs: f64) -> Schedule {
    Schedule::new(Pair::FrontRightRearLeft, tick_secs, tick_secs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::RobotState;
    use nalgebra::UnitQuaternion;
    use std::sync::{Arc, Mutex};

    fn standing(model: &Model, velocity: Vector3<f64>) -> RobotState {
        RobotState {
            position: Vector3::new(0.0, 0.0, model.standing_height()),
            rotation: UnitQuaternion::identity(),
            velocity,
            angular_velocity: Vector3::zeros(),
            joints: Leg::ALL.map(|leg| model.nominal(leg)),
            joint_speeds: [Vector3::zeros(); 4],
        }
    }

    fn controller() -> (Controller, Model) {
        let config = Config::default();
        let model = Model::new(&config.robot);
        (Controller::new(&config, &model), model)
    }

    const GAIT: task::Constant = task::Constant { velocity_mps: 2.0, stride_m: 0.4, lift_m: 0.03, step_secs: 0.2 };

    #[test]
    fn a_step_that_is_cut_keeps_a_stride_that_fits_the_speed() {
        let (mut controller, model) = controller();
        let state = standing(&model, Vector3::new(2.0, 0.0, 0.0));
        controller.begin(&GAIT, &Body::new(&model, &state));
        let longest = controller.config.gait.stride_max_m;
        assert!((controller.schedule.duration_secs() - longest / 2.0).abs() <= controller.tick_secs);
        assert!((controller.gait.stride_m - longest).abs() < 1e-9, "S = v Δt before and after: {:?}", controller.gait);
    }

    #[test]
    fn the_speed_aimed_at_waits_for_a_robot_that_cannot_follow() {
        let (mut controller, model) = controller();
        let (slow, fast) = (standing(&model, Vector3::zeros()), standing(&model, Vector3::x()));
        let lead = controller.config.gait.pace_lead_mps;
        for (state, expected) in [(&slow, lead), (&fast, 1.0 + lead)] {
            controller.begin(&GAIT, &Body::new(&model, state));
            (0..300).for_each(|_| _ = controller.torques(&Body::new(&model, state), &Contacts::default()));
            assert!((controller.pace - expected).abs() < 1e-9, "{} m/s, expected {expected}", controller.pace);
        }
        // And in braking.
        controller.begin(&task::Constant { velocity_mps: -1.0, ..GAIT }, &Body::new(&model, &fast));
        (0..300).for_each(|_| _ = controller.torques(&Body::new(&model, &fast), &Contacts::default()));
        assert!((controller.pace - (1.0 - lead)).abs() < 1e-9, "{} m/s", controller.pace);
    }

    #[test]
    fn a_standing_foot_is_held_and_one_that_touches_nothing_is_pushed_down() {
        let (mut gripping, model) = controller();
        let (mut loose, _) = controller();
        loose.config.swing.grip_nspm = 0.0;
        let state = standing(&model, Vector3::x());
        let body = Body::new(&model, &state);
        let mut contacts = Contacts { normal: [30.0; 4], feet: [true; 4], ..Contacts::default() };
        contacts.feet[Leg::FrontRight.index()] = false;
        for controller in [&mut gripping, &mut loose] {
            controller.begin(&GAIT, &body);
        }
        let (held, free) = (gripping.torques(&body, &contacts), loose.torques(&body, &contacts));
        let swing = &gripping.config.swing;
        for (leg, down) in [(Leg::RearLeft, 0.0), (Leg::FrontRight, swing.reach_down_mps)] {
            let expected = body.grip_torques(leg, &(Vector3::z() * -down), swing.grip_nspm);
            let found = held[leg.index()] - free[leg.index()];
            assert!((found - expected).norm() < 1e-9 && expected.norm() > 0.1, "{leg:?}: {found}, expected {expected}");
        }
    }

    #[test]
    fn a_late_leg_bears_nothing_now_but_soon() {
        let (mut controller, model) = controller();
        let state = standing(&model, Vector3::zeros());
        let body = Body::new(&model, &state);
        let bears = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&bears);
        controller.set_watcher(Box::new(move |_, horizon| {
            let at = |step: usize| horizon[step].feet.map(|foot| foot.is_some());
            seen.lock().expect("nobody panics").push((at(0), at(1)));
        }));
        // Nothing is touched in the whole swing of FL + RR, which are late when the other pair sets off.
        let ticks = controller.begin(&GAIT, &body);
        (0..ticks).for_each(|_| _ = controller.torques(&body, &Contacts::default()));
        controller.begin(&GAIT, &body);
        controller.torques(&body, &Contacts::default());
        let last = bears.lock().expect("nobody panics").pop().expect("it was asked");
        assert_eq!(last, ([false; 4], [true, false, false, true]));
        assert_eq!(controller.counts().late_contacts, 2);
    }
}
