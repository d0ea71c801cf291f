//! Status snapshots: the same fields on both sides, so one macro writes both directions.

use crate::v1;
use herd_common::status as domain;

/// Conversions between two structs whose fields have the same names and types.
macro_rules! mirror {
    ($name:ident { $($field:ident),* $(,)? }) => {
        impl From<domain::$name> for v1::$name {
            fn from(from: domain::$name) -> Self {
                Self { $($field: from.$field),* }
            }
        }

        impl From<v1::$name> for domain::$name {
            fn from(from: v1::$name) -> Self {
                Self { $($field: from.$field),* }
            }
        }
    };
}

mirror!(Rates { episodes, transitions, updates });
mirror!(Returns { mean, last, best, evaluation, seconds, fall_rate });
mirror!(Replay { len, capacity, staleness });
mirror!(Losses { critic, actor, value, skipped });
mirror!(History { journal_bytes, episodes_since_checkpoint, checkpoint_age_secs });
mirror!(Time { updates_secs, sync_secs, idle_secs });
mirror!(Traffic { received_bytes, sent_bytes });
mirror!(Qp { solves, failures, p50_micros, p99_micros });

impl From<domain::Status> for v1::Status {
    fn from(status: domain::Status) -> Self {
        Self {
            run: status.run,
            epoch: status.epoch,
            phase: status.phase,
            schedule: status.schedule,
            durability: status.durability,
            episodes: status.episodes,
            episodes_target: status.episodes_target,
            transitions: status.transitions,
            updates: status.updates,
            policy_version: status.policy_version,
            uptime_secs: status.uptime_secs,
            eta_secs: status.eta_secs,
            bottleneck: status.bottleneck,
            rates: Some(status.rates.into()),
            returns: Some(status.returns.into()),
            replay: Some(status.replay.into()),
            losses: Some(status.losses.into()),
            history: Some(status.history.into()),
            qp: Some(status.qp.into()),
            time: Some(status.time.into()),
            traffic: Some(status.traffic.into()),
            endings: status.endings.into_iter().map(|(ending, count)| v1::EndingCount { ending, count }).collect(),
            actors: status.actors.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<v1::Status> for domain::Status {
    fn from(status: v1::Status) -> Self {
        Self {
            run: status.run,
            epoch: status.epoch,
            phase: status.phase,
            schedule: status.schedule,
            durability: status.durability,
            episodes: status.episodes,
            episodes_target: status.episodes_target,
            transitions: status.transitions,
            updates: status.updates,
            policy_version: status.policy_version,
            uptime_secs: status.uptime_secs,
            eta_secs: status.eta_secs,
            bottleneck: status.bottleneck,
            rates: status.rates.unwrap_or_default().into(),
            returns: status.returns.unwrap_or_default().into(),
            replay: status.replay.unwrap_or_default().into(),
            losses: status.losses.unwrap_or_default().into(),
            history: status.history.unwrap_or_default().into(),
            qp: status.qp.unwrap_or_default().into(),
            time: status.time.unwrap_or_default().into(),
            traffic: status.traffic.unwrap_or_default().into(),
            endings: status.endings.into_iter().map(|v1::EndingCount { ending, count }| (ending, count)).collect(),
            actors: status.actors.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<domain::Actor> for v1::Actor {
    fn from(actor: domain::Actor) -> Self {
        Self {
            id: actor.id,
            host: actor.host,
            pid: actor.pid,
            robots: actor.robots,
            leases: actor.leases,
            episodes: actor.episodes,
            falls: actor.falls,
            realtime_factor: actor.realtime_factor,
            policy_version: actor.policy_version,
            last_seen_secs: actor.last_seen_secs,
            qp: Some(actor.qp.into()),
        }
    }
}

impl From<v1::Actor> for domain::Actor {
    fn from(actor: v1::Actor) -> Self {
        Self {
            id: actor.id,
            host: actor.host,
            pid: actor.pid,
            robots: actor.robots,
            leases: actor.leases,
            episodes: actor.episodes,
            falls: actor.falls,
            realtime_factor: actor.realtime_factor,
            policy_version: actor.policy_version,
            last_seen_secs: actor.last_seen_secs,
            qp: actor.qp.unwrap_or_default().into(),
        }
    }
}

impl From<domain::Heartbeat> for v1::Heartbeat {
    fn from(beat: domain::Heartbeat) -> Self {
        Self { realtime_factor: beat.realtime_factor, policy_version: beat.policy_version, qp: Some(beat.qp.into()) }
    }
}

impl From<v1::Heartbeat> for domain::Heartbeat {
    fn from(beat: v1::Heartbeat) -> Self {
        // Shown to people only, so a nonsensical number is shown as none rather than refused.
        let finite = |x: f64| if x.is_finite() { x.clamp(0.0, 1e9) } else { 0.0 };
        let qp: domain::Qp = beat.qp.unwrap_or_default().into();
        Self {
            realtime_factor: finite(beat.realtime_factor),
            policy_version: beat.policy_version,
            qp: domain::Qp { p50_micros: finite(qp.p50_micros), p99_micros: finite(qp.p99_micros), ..qp },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_round_trips() {
        let status = domain::Status {
            run: "abc".into(),
            episodes: 3,
            eta_secs: Some(2.5),
            returns: domain::Returns { mean: 1.0, evaluation: Some(7.0), ..Default::default() },
            endings: vec![("timed_out".into(), 2)],
            actors: vec![domain::Actor { id: 4, host: "h".into(), ..Default::default() }],
            ..Default::default()
        };
        assert_eq!(domain::Status::from(v1::Status::from(status.clone())), status);
    }
}
