//! The contact sequence of a trot: diagonal pairs swing in turn, each for one step duration.
//!
//! | symbol | name                                  | unit  |
//! |--------|---------------------------------------|-------|
//! | Δt     | duration of a swing, so of a stance   | ticks |
//! | ahead  | time from now                         | s     |
//!
//! Duty factor .5: one pair swings while the other stands. The future beyond the present swing is not decided yet; it is
//! predicted to go on with the present Δt. A robot that is to stay where it is has a stance of all legs in place of a swing.

use crate::robot::Leg;

/// A diagonal pair of legs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pair {
    /// Front left and rear right.
    FrontLeftRearRight,
    /// Front right and rear left.
    FrontRightRearLeft,
}

/// Where in the sequence the robot is.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    swinging: Pair,
    /// All legs stand; `swinging` swung last.
    halted: bool,
    duration_ticks: u32,
    elapsed_ticks: u32,
    tick_secs: f64,
}

impl Pair {
    /// The pair of a leg.
    pub fn of(leg: Leg) -> Self {
        if leg.side() * leg.front() > 0.0 { Self::FrontLeftRearRight } else { Self::FrontRightRearLeft }
    }

    /// The other pair.
    pub fn other(self) -> Self {
        match self {
            Self::FrontLeftRearRight => Self::FrontRightRearLeft,
            Self::FrontRightRearLeft => Self::FrontLeftRearRight,
        }
    }
}

impl Schedule {
    /// The beginning of a swing of `swinging` that lasts `duration_secs`, rounded to whole ticks.
    pub fn new(swinging: Pair, duration_secs: f64, tick_secs: f64) -> Self {
        let duration_ticks = ((duration_secs / tick_secs).round() as u32).max(1);
        Self { swinging, halted: false, duration_ticks, elapsed_ticks: 0, tick_secs }
    }

    /// The beginning of a stance of all legs that lasts as long; the pair whose turn it was keeps it.
    pub fn halt(&self, duration_secs: f64) -> Self {
        Self { halted: true, ..Self::new(self.swinging, duration_secs, self.tick_secs) }
    }

    /// Goes on by one tick.
    pub fn tick(&mut self) {
        self.elapsed_ticks += 1;
    }

    /// Ticks of this swing.
    pub fn duration_ticks(&self) -> u32 {
        self.duration_ticks
    }

    /// Ticks of this swing that are over.
    pub fn elapsed_ticks(&self) -> u32 {
        self.elapsed_ticks
    }

    /// Δt, s.
    pub fn duration_secs(&self) -> f64 {
        f64::from(self.duration_ticks) * self.tick_secs
    }

    /// Time since the swing began, s.
    pub fn elapsed_secs(&self) -> f64 {
        f64::from(self.elapsed_ticks) * self.tick_secs
    }

    /// Time until the pairs change, s.
    pub fn remaining_secs(&self) -> f64 {
        f64::from(self.duration_ticks.saturating_sub(self.elapsed_ticks)) * self.tick_secs
    }

    /// The share of the swing that is over.
    pub fn phase(&self) -> f64 {
        f64::from(self.elapsed_ticks) / f64::from(self.duration_ticks)
    }

    /// True when all legs are meant to stand.
    pub fn is_halted(&self) -> bool {
        self.halted
    }

    /// The pair in the air, or that was last.
    pub fn swinging(&self) -> Pair {
        self.swinging
    }

    /// True when this leg is meant to be in the air now.
    pub fn swings(&self, leg: Leg) -> bool {
        !self.halted && Pair::of(leg) == self.swinging
    }

    /// How many changes of pairs lie between now and `ahead`.
    fn changes_until(&self, ahead: f64) -> u32 {
        if self.halted {
            return 0;
        }
        // Half a tick of slack, so that sums of step lengths cannot fall on the wrong side of a change.
        let beyond = ahead + self.tick_secs / 2.0 - self.remaining_secs();
        if beyond < 0.0 { 0 } else { 1 + (beyond / self.duration_secs()) as u32 }
    }

    /// True when this leg is meant to stand at `ahead`.
    pub fn stands_at(&self, leg: Leg, ahead: f64) -> bool {
        let swaps = self.changes_until(ahead) % 2 == 1;
        self.swings(leg) == swaps
    }

    /// Time from now at which the stance of a leg that stands at `ahead` begins, s; `None` when it is the present one.
    pub fn touchdown_before(&self, ahead: f64) -> Option<f64> {
        let changes = self.changes_until(ahead);
        (changes > 0).then(|| self.remaining_secs() + f64::from(changes - 1) * self.duration_secs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn pairs_are_diagonal() {
        for leg in Leg::ALL {
            assert_ne!(Pair::of(leg), Pair::of(leg.mirrored()));
        }
        assert_eq!(Pair::of(Leg::FrontLeft), Pair::of(Leg::RearRight));
    }

    #[test]
    fn a_halted_robot_stands_on_all_legs_and_goes_on_with_the_pair_whose_turn_it_was() {
        let schedule = Schedule::new(Pair::FrontLeftRearRight, 0.15, 0.002);
        let halted = schedule.halt(0.15).halt(0.1);
        for leg in Leg::ALL {
            assert!(!halted.swings(leg) && halted.stands_at(leg, 0.0) && halted.stands_at(leg, 0.2), "{leg:?}");
        }
        assert_eq!((halted.touchdown_before(0.3), halted.duration_ticks()), (None, 50));
        assert_eq!(halted.swinging(), schedule.swinging());
    }

    proptest! {
        #[test]
        fn two_legs_stand_at_any_time_and_pairs_alternate(
            duration in 0.1..0.2, ticks in 0_u32..40, ahead in 0.0..0.6,
        ) {
            let mut schedule = Schedule::new(Pair::FrontLeftRearRight, duration, 0.002);
            (0..ticks).for_each(|_| schedule.tick());
            prop_assert_eq!(Leg::ALL.iter().filter(|leg| schedule.stands_at(**leg, ahead)).count(), 2);
            for leg in Leg::ALL {
                let later = ahead + schedule.duration_secs();
                prop_assert_eq!(schedule.stands_at(leg, ahead), !schedule.stands_at(leg, later));
                prop_assert_eq!(schedule.stands_at(leg, 0.0), !schedule.swings(leg));
            }
        }

        #[test]
        fn touchdowns_are_changes_of_pairs(duration in 0.1..0.2, ticks in 0_u32..40, ahead in 0.0..0.6) {
            let mut schedule = Schedule::new(Pair::FrontRightRearLeft, duration, 0.002);
            (0..ticks).for_each(|_| schedule.tick());
            let standing = Leg::ALL.into_iter().find(|leg| schedule.stands_at(*leg, ahead)).expect("two stand");
            match schedule.touchdown_before(ahead) {
                None => prop_assert!(!schedule.swings(standing)),
                Some(touchdown) => {
                    prop_assert!(touchdown <= ahead + 0.002);
                    prop_assert!(schedule.stands_at(standing, touchdown));
                    prop_assert!(!schedule.stands_at(standing, touchdown - 0.004));
                }
            }
        }
    }
}
