//! The figures of one measured point, from what was seen at both ends of its window.

use super::bottleneck::{self, Signs};
use super::meter::{Latency, Lost, Totals};
use herd_common::status::Status;
use serde::Serialize;

/// What was seen at one moment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sight {
    /// When, s from any fixed moment.
    pub(crate) at: f64,
    /// What the learner says.
    pub(crate) status: Status,
    /// CPU time of the learner so far, s.
    pub(crate) learner_cpu_secs: f64,
    /// CPU time of all actors so far, s.
    pub(crate) actors_cpu_secs: f64,
    /// CPU time of everything on this machine so far, s.
    pub(crate) machine_cpu_secs: f64,
}

/// What does not change while a point is measured.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Setting {
    /// Actors connected.
    pub(crate) actors: u32,
    /// Which of the points with this many actors, from 1.
    pub(crate) round: u32,
    /// Robots of each.
    pub(crate) robots: u32,
    /// They simulate nothing.
    pub(crate) synthetic: bool,
    /// They pause between episodes.
    pub(crate) paced: bool,
    /// Episodes that the schedule allows at once.
    pub(crate) allowed: u64,
    /// Cores of this machine.
    pub(crate) cores: u32,
}

/// One point of a scaling curve.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Figures {
    /// What was measured.
    #[serde(flatten)]
    pub(crate) setting: Setting,
    /// Length of the window, s.
    pub(crate) secs: f64,
    /// Decisions committed per second.
    pub(crate) transitions_per_sec: f64,
    /// Updates per second.
    pub(crate) updates_per_sec: f64,
    /// Episodes committed per second.
    pub(crate) episodes_per_sec: f64,
    /// Bytes per second that the learner received and sent, HTTP/2 included.
    pub(crate) received_bytes_per_sec: f64,
    /// See above.
    pub(crate) sent_bytes_per_sec: f64,
    /// Policy versions that committed episodes were behind.
    pub(crate) staleness: f64,
    /// End of an episode sent → its commit acknowledged; synthetic actors only.
    pub(crate) commit: Option<Latency>,
    /// Policy published → in place at a subscriber.
    pub(crate) broadcast: Option<Latency>,
    /// Bytes of one policy for one subscriber: its gRPC message; HTTP/2 adds nine a frame.
    pub(crate) policy_bytes: Option<u64>,
    /// Subscribers that stopped following the policies; broadcast speaks of the others.
    pub(crate) lost: Option<Lost>,
    /// What the bottleneck was told by.
    pub(crate) signs: Signs,
    /// Most memory that the learner had at once, bytes.
    pub(crate) learner_peak_bytes: u64,
    /// What synthetic actors counted from beginning to end.
    pub(crate) acknowledged: Option<Totals>,
    /// What the learner counted from beginning to end.
    pub(crate) committed: Totals,
    /// What limits this point.
    pub(crate) bottleneck: String,
}

impl Setting {
    /// The number of actors, and which time when it is not the first.
    pub(crate) fn name(&self) -> String {
        match self.round {
            0 | 1 => self.actors.to_string(),
            round => format!("{} #{round}", self.actors),
        }
    }
}

impl Figures {
    /// The figures between two sights.
    pub(crate) fn between(setting: Setting, from: &Sight, to: &Sight) -> Self {
        let secs = (to.at - from.at).max(f64::MIN_POSITIVE);
        let per_sec = |of: fn(&Status) -> u64| of(&to.status).saturating_sub(of(&from.status)) as f64 / secs;
        let share = |of: fn(&Status) -> f64| ((of(&to.status) - of(&from.status)) / secs).clamp(0.0, 1.0);
        let cores = |of: fn(&Sight) -> f64| (of(to) - of(from)) / secs;
        let (learner_cores, actors_cores) = (cores(|s| s.learner_cpu_secs), cores(|s| s.actors_cpu_secs).max(0.0));
        let signs = Signs {
            updates: share(|status| status.time.updates_secs),
            sync: share(|status| status.time.sync_secs),
            idle: share(|status| status.time.idle_secs),
            learner_cores,
            actors_cores,
            other_cores: (cores(|s| s.machine_cpu_secs) - learner_cores - actors_cores).max(0.0),
            cores: f64::from(setting.cores),
            robots: u64::from(setting.actors) * u64::from(setting.robots),
            allowed: setting.allowed,
            paced: setting.paced,
        };
        Self {
            setting,
            secs,
            transitions_per_sec: per_sec(|status| status.transitions),
            updates_per_sec: per_sec(|status| status.updates),
            episodes_per_sec: per_sec(|status| status.episodes),
            received_bytes_per_sec: per_sec(|status| status.traffic.received_bytes),
            sent_bytes_per_sec: per_sec(|status| status.traffic.sent_bytes),
            staleness: to.status.replay.staleness,
            commit: None,
            broadcast: None,
            policy_bytes: None,
            lost: None,
            signs,
            learner_peak_bytes: 0,
            acknowledged: None,
            committed: Totals::default(),
            bottleneck: bottleneck::name(&signs),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_differences_over_the_window() {
        let mut from = Sight { at: 10.0, ..Sight::default() };
        (from.status.transitions, from.status.traffic.received_bytes) = (1000, 5000);
        let mut to = Sight { at: 14.0, learner_cpu_secs: 2.0, actors_cpu_secs: 6.0, ..Sight::default() };
        (to.status.transitions, to.status.traffic.received_bytes) = (9000, 45_000);
        (to.status.time.updates_secs, to.status.time.idle_secs) = (3.8, 0.1);
        let setting = Setting { actors: 2, robots: 3, cores: 2, allowed: 17, ..Setting::default() };
        let figures = Figures::between(setting, &from, &to);
        assert_eq!((figures.transitions_per_sec, figures.received_bytes_per_sec), (2000.0, 10_000.0));
        assert_eq!((figures.signs.learner_cores, figures.signs.actors_cores, figures.signs.robots), (0.5, 1.5, 6));
        assert!(figures.bottleneck.starts_with("learner: updates take 95 %"), "{}", figures.bottleneck);
    }
}
