//! A world that another program simulates: each call is a question, each answer a snapshot.
//!
//! How questions travel is the asker's affair, and so are ground and payload: they are in no question. When it has no answer any more the world has diverged, which ends the
//! episode.

use super::snapshot::flat;
use super::{Contacts, Plant, RobotState, Snapshot, Spawn};
use nalgebra::Vector3;
use serde::Serialize;

/// Where a robot starts, at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pose {
    /// Trunk origin, world, m.
    pub position: [f64; 3],
    /// World from body: w, x, y, z.
    pub quaternion: [f64; 4],
    /// Joint angles, rad.
    pub joints: [f64; 12],
}

/// What the other program is asked to do; each time it answers with the robot as it is then.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ask {
    /// Start afresh from this pose, at rest.
    Reset(Pose),
    /// Add this to the trunk's velocity, world, m/s.
    AddVelocity([f64; 3]),
    /// Simulate one tick.
    Tick {
        /// Joint torques to hold, N·m.
        torques: [f64; 12],
        /// Force on the trunk's origin, world, N.
        #[serde(skip_serializing_if = "Option::is_none")]
        push: Option<[f64; 3]>,
    },
}

/// Puts a question and waits for the answer; none when there will be no more.
pub type Asker = Box<dyn FnMut(&Ask) -> Option<Snapshot> + Send>;

/// Makes worlds that this asker reaches; `asker` is called for each.
pub fn remote(mut asker: Box<dyn FnMut() -> Asker + Send>) -> Spawn {
    Box::new(move |_, _, _, start| {
        let q = start.rotation.quaternion();
        let pose =
            Pose { position: start.position.into(), quaternion: [q.w, q.i, q.j, q.k], joints: flat(&start.joints) };
        // What is seen if there is no answer to the very first question.
        let still = RobotState {
            position: start.position,
            rotation: start.rotation,
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            joints: start.joints,
            joint_speeds: [Vector3::zeros(); 4],
        };
        let last = Snapshot::new(&still, &Contacts::default());
        let mut world = Remote { asker: asker(), last, silent: false, push: None };
        world.ask(&Ask::Reset(pose));
        Box::new(world)
    })
}

struct Remote {
    asker: Asker,
    last: Snapshot,
    silent: bool,
    push: Option<(Vector3<f64>, u32)>,
}

impl Remote {
    fn ask(&mut self, ask: &Ask) {
        if self.silent {
            return;
        }
        match (self.asker)(ask) {
            Some(snapshot) => self.last = snapshot,
            None => self.silent = true,
        }
    }
}

impl Plant for Remote {
    fn tick(&mut self, torques: &[Vector3<f64>; 4]) {
        let push = self.push.take();
        self.ask(&Ask::Tick { torques: flat(torques), push: push.map(|(force, _)| force.into()) });
        self.push = push.and_then(|(force, ticks)| (ticks > 1).then_some((force, ticks - 1)));
    }

    fn push(&mut self, force: &Vector3<f64>, ticks: u32) {
        self.push = (ticks > 0).then_some((*force, ticks));
    }

    fn add_velocity(&mut self, change: &Vector3<f64>) {
        self.ask(&Ask::AddVelocity((*change).into()));
    }

    fn state(&self) -> RobotState {
        self.last.state()
    }

    fn contacts(&self) -> Contacts {
        self.last.contacts()
    }

    fn has_diverged(&self) -> bool {
        self.silent
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Start, World, legs};
    use super::*;
    use crate::env::{Env, Step};
    use herd_common::config::Config;
    use herd_common::episode::Ending;
    use herd_common::seed::Seed;
    use nalgebra::{Quaternion, UnitQuaternion};

    /// Another program that happens to use rapier too, and answers this often.
    fn other(config: &Config, mut answers: u32) -> Asker {
        let config = config.clone();
        let model = crate::robot::Model::new(&config.robot);
        let mut world: Option<World> = None;
        Box::new(move |ask| {
            answers = answers.checked_sub(1)?;
            if let Ask::Reset(pose) = ask {
                let [w, x, y, z] = pose.quaternion;
                let start = Start {
                    position: pose.position.into(),
                    rotation: UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
                    joints: legs(&pose.joints),
                };
                world = Some(World::new(&model, &config.sim, &start));
            }
            let world = world.as_mut()?;
            match ask {
                Ask::Reset(_) => {}
                Ask::AddVelocity(change) => world.add_velocity(&(*change).into()),
                Ask::Tick { torques, push } => {
                    if let Some(force) = push {
                        world.push(&(*force).into(), 1);
                    }
                    world.tick(&legs(torques));
                }
            }
            Some(Snapshot::new(&world.state(), &world.contacts()))
        })
    }

    fn episode(env: &mut Env) -> Vec<Step> {
        env.reset(Seed::from_number(4));
        env.push(&Vector3::new(0.0, 30.0, 0.0), 0.1);
        let mut steps = Vec::new();
        while steps.last().is_none_or(|step: &Step| step.ending.is_none()) {
            steps.push(env.step(&[]));
        }
        steps
    }

    #[test]
    fn it_matters_not_who_simulates() {
        let sets = ["task.kind=constant".to_owned(), "task.episode_secs=0.6".to_owned()];
        let config = Config::load(None, &sets).expect("valid");
        let theirs = config.clone();
        let spawn = remote(Box::new(move || other(&theirs, u32::MAX)));
        let there = episode(&mut Env::new(&config).with_plant(spawn));
        let here = episode(&mut Env::new(&config));
        assert_eq!(there.len(), here.len());
        for (a, b) in there.iter().zip(&here) {
            // The quaternion is normalised on its way, which moves its last bits.
            assert!((a.reward - b.reward).abs() < 1e-2, "{} {}", a.reward, b.reward);
            assert_eq!(a.ending, b.ending);
        }
    }

    #[test]
    fn silence_ends_the_episode() {
        let sets = ["task.kind=constant".to_owned()];
        let config = Config::load(None, &sets).expect("valid");
        let theirs = config.clone();
        let spawn = remote(Box::new(move || other(&theirs, 150)));
        let steps = episode(&mut Env::new(&config).with_plant(spawn));
        assert_eq!((steps.len(), steps[0].ending), (1, Some(Ending::Diverged)));
    }
}
