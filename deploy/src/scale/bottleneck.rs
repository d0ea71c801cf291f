//! Names what limits a run, by rules that are written down and tested.

use serde::Serialize;

/// What the rules look at, over one window of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Signs {
    /// Share of the training thread's time in updates.
    pub(crate) updates: f64,
    /// Share of it waiting for the disk.
    pub(crate) sync: f64,
    /// Share of it waiting for episodes.
    pub(crate) idle: f64,
    /// Cores that the learner keeps busy.
    pub(crate) learner_cores: f64,
    /// Cores that all actors here keep busy.
    pub(crate) actors_cores: f64,
    /// Cores that anything else here keeps busy.
    pub(crate) other_cores: f64,
    /// Cores of this machine.
    pub(crate) cores: f64,
    /// Episodes that all robots together could run at once.
    pub(crate) robots: u64,
    /// Episodes that the schedule allows at once.
    pub(crate) allowed: u64,
    /// Synthetic actors are told to pause between episodes.
    pub(crate) paced: bool,
}

/// A training thread that waits less than this is what the rest waits for.
const BUSY_IDLE: f64 = 0.15;
/// Use of all cores from which on the machine is full.
const FULL: f64 = 0.9;

/// Use of all cores by strangers from which on figures are told with a warning.
const STRANGERS: f64 = 0.15;

/// The bottleneck, in one line.
pub(crate) fn name(signs: &Signs) -> String {
    let told = limit(signs);
    if signs.other_cores < STRANGERS * signs.cores {
        return told;
    }
    format!("{told}; other programs keep {:.1} of {:.0} cores busy", signs.other_cores, signs.cores)
}

fn limit(signs: &Signs) -> String {
    let Signs { updates, sync, idle, learner_cores, actors_cores, cores, robots, allowed, paced, .. } = *signs;
    let percent = |share: f64| format!("{:.0} %", share * 100.0);
    let messages = (1.0 - updates - sync - idle).max(0.0);
    let busy = idle < BUSY_IDLE;
    if busy && updates >= sync.max(messages) {
        return format!("learner: updates take {} of its training thread", percent(updates));
    }
    if learner_cores + actors_cores > FULL * cores {
        return format!(
            "CPU of this machine: learner {learner_cores:.2}, actors {actors_cores:.2} of {cores:.0} cores"
        );
    }
    if busy && sync >= messages {
        return format!("disk: the training thread waits for it {} of the time", percent(sync));
    }
    if busy {
        return format!("learner: messages and bookkeeping take {} of its training thread", percent(messages));
    }
    if robots > allowed {
        return format!("leases: {robots} robots share {allowed}; a larger schedule.lag gives more");
    }
    let why = if paced { "pauses that were asked for" } else { "the time that episodes take" };
    format!("actors: {why}; the learner waits {} of the time", percent(idle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(change: impl FnOnce(&mut Signs), begins: &str) {
        let mut signs = Signs { idle: 0.5, cores: 2.0, robots: 4, allowed: 17, ..Signs::default() };
        change(&mut signs);
        let told = name(&signs);
        assert!(told.starts_with(begins), "{told}");
    }

    #[test]
    fn each_rule_names_its_own() {
        check(|s| (s.idle, s.updates) = (0.05, 0.9), "learner: updates take 90 %");
        check(|s| (s.idle, s.sync) = (0.05, 0.8), "disk: the training thread waits for it 80 %");
        check(|s| s.idle = 0.05, "learner: messages and bookkeeping take 95 %");
        check(
            |s| (s.learner_cores, s.actors_cores) = (0.4, 1.5),
            "CPU of this machine: learner 0.40, actors 1.50 of 2",
        );
        check(|s| s.robots = 20, "leases: 20 robots share 17");
        check(|_| {}, "actors: the time that episodes take; the learner waits 50 %");
        check(|s| s.other_cores = 0.2, "actors: the time that episodes take; the learner waits 50 % of the time");
        let busy = Signs { idle: 0.5, cores: 2.0, other_cores: 1.2, allowed: 1, ..Signs::default() };
        assert!(name(&busy).ends_with("; other programs keep 1.2 of 2 cores busy"), "{}", name(&busy));
        check(|s| s.paced = true, "actors: pauses that were asked for");
    }

    #[test]
    fn updates_come_before_a_full_machine_and_that_before_the_disk() {
        check(|s| (s.idle, s.updates, s.learner_cores, s.actors_cores) = (0.0, 0.9, 1.0, 1.0), "learner: updates");
        check(|s| (s.idle, s.sync, s.learner_cores, s.actors_cores) = (0.0, 0.9, 1.0, 1.0), "CPU of this machine");
    }
}
