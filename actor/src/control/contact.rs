//! Which legs carry weight: the schedule's word, corrected by what the feet feel.
//!
//! A foot that touches the ground late in its swing stands at once; one that finds no ground at the end of its swing
//! reaches down until it does.

use crate::gait::{Schedule, Swing};
use crate::robot::Leg;
use crate::sim::Contacts;
use herd_common::config::control;
use herd_common::episode::Counts;
use nalgebra::Vector3;

/// What a leg is doing.
#[derive(Clone, Copy, Debug)]
pub(super) enum Duty {
    /// It carries weight.
    Stands,
    /// It is in the air, or reaches for ground that should have been there.
    Flies {
        /// Its path.
        swing: Swing,
        /// Ticks since it left the ground.
        ticks: u32,
        /// Where it is to land, world, m.
        target: Vector3<f64>,
    },
}

impl Duty {
    pub(super) fn stands(&self) -> bool {
        matches!(self, Self::Stands)
    }
}

/// Lets legs that touch the ground stand; true when any did.
pub(super) fn notice(
    duties: &mut [Duty; 4],
    schedule: &Schedule,
    contacts: &Contacts,
    config: &control::Swing,
    counts: &mut Counts,
) -> bool {
    let mut changed = false;
    for leg in Leg::ALL {
        let duty = &mut duties[leg.index()];
        let touches = contacts.feet[leg.index()] && contacts.normal[leg.index()] > config.early_contact_n;
        if duty.stands() || !touches {
            continue;
        }
        let flying = schedule.swings(leg);
        if flying && schedule.phase() < config.early_contact_phase {
            continue;
        }
        counts.early_contacts += u64::from(flying);
        *duty = Duty::Stands;
        changed = true;
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::Pair;
    use herd_common::config::Config;

    #[test]
    fn a_foot_that_has_yet_to_arrive_does_not_stand() {
        let config = Config::default();
        let mut schedule = Schedule::new(Pair::FrontLeftRearRight, 0.2, config.sim.tick_secs);
        (0..90).for_each(|_| schedule.tick());
        let swing = Swing { from: Vector3::zeros(), lift: 0.03, duration: 0.2, advance_share: 1.0 };
        let flies = Duty::Flies { swing, ticks: 90, target: Vector3::zeros() };
        let mut duties = [flies, Duty::Stands, Duty::Stands, flies];
        let mut counts = Counts::default();
        let mut notices = |contacts: &Contacts| {
            let changed = notice(&mut duties, &schedule, contacts, &config.control.swing, &mut counts);
            (changed, duties.map(|duty| duty.stands()), counts.early_contacts)
        };
        let slowed = Contacts { normal: [60.0; 4], feet: [false, true, true, false], ..Contacts::default() };
        assert_eq!(notices(&slowed), (false, [false, true, true, false], 0));
        let landed = Contacts { feet: [true, true, true, false], ..slowed };
        assert_eq!(notices(&landed), (true, [true, true, true, false], 1));
    }
}
