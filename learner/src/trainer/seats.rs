//! The connected actors as the trainer sees them: who they are, what they report, where their notices go.

use super::command::{Full, Newcomer, Notice};
use herd_common::status::{Actor, Heartbeat, Qp};
use herd_common::{caps, episode::Outcome};
use std::collections::BTreeMap;
use tokio::sync::mpsc;

/// One connected actor.
#[derive(Debug)]
struct Seat {
    newcomer: Newcomer,
    outbox: mpsc::Sender<Notice>,
    beat: Heartbeat,
    seen_at: f64,
    episodes: u64,
    falls: u64,
}

/// All connected actors.
#[derive(Debug, Default)]
pub(super) struct Seats {
    seats: BTreeMap<u64, Seat>,
    next_id: u64,
}

impl Seats {
    /// Seats an actor and gives it its number.
    pub(super) fn join(&mut self, newcomer: Newcomer, outbox: mpsc::Sender<Notice>, now: f64) -> Result<u64, Full> {
        if self.seats.len() >= caps::ACTORS {
            return Err(Full);
        }
        let id = self.next_id;
        self.next_id += 1;
        let seat = Seat { newcomer, outbox, beat: Heartbeat::default(), seen_at: now, episodes: 0, falls: 0 };
        self.seats.insert(id, seat);
        Ok(id)
    }

    /// Forgets an actor; its stream ends.
    pub(super) fn leave(&mut self, actor: u64) {
        self.seats.remove(&actor);
    }

    /// Notes that an actor spoke.
    pub(super) fn seen(&mut self, actor: u64, now: f64) {
        if let Some(seat) = self.seats.get_mut(&actor) {
            seat.seen_at = now;
        }
    }

    /// Takes an actor's figures.
    pub(super) fn beat(&mut self, actor: u64, beat: Heartbeat) {
        if let Some(seat) = self.seats.get_mut(&actor) {
            seat.beat = beat;
        }
    }

    /// Counts a finished episode.
    pub(super) fn finished(&mut self, actor: u64, outcome: &Outcome) {
        if let Some(seat) = self.seats.get_mut(&actor) {
            seat.episodes += 1;
            seat.falls += u64::from(outcome.ending.is_fall());
        }
    }

    /// Tells an actor something; false when it is gone or does not read, and then it should leave.
    pub(super) fn tell(&self, actor: u64, notice: Notice) -> bool {
        self.seats.get(&actor).is_some_and(|seat| seat.outbox.try_send(notice).is_ok())
    }

    /// Tells every actor the same; those that do not read learn it from the end of their stream.
    pub(super) fn tell_all(&self, notice: &Notice) {
        for seat in self.seats.values() {
            let _ = seat.outbox.try_send(notice.clone());
        }
    }

    /// Numbers and robots, by number.
    pub(super) fn robots(&self) -> Vec<(u64, u32)> {
        self.seats.iter().map(|(id, seat)| (*id, seat.newcomer.robots)).collect()
    }

    /// Actors that said nothing for too long.
    pub(super) fn silent(&self, now: f64) -> Vec<u64> {
        let patience = caps::ACTOR_SILENCE.as_secs_f64();
        self.seats.iter().filter(|(_, seat)| now - seat.seen_at > patience).map(|(id, _)| *id).collect()
    }

    /// Connected actors.
    pub(super) fn len(&self) -> usize {
        self.seats.len()
    }

    /// Rows for status.
    pub(super) fn rows(&self, now: f64, leases: impl Fn(u64) -> usize) -> Vec<Actor> {
        let row = |(id, seat): (&u64, &Seat)| Actor {
            id: *id,
            host: seat.newcomer.host.clone(),
            pid: seat.newcomer.pid,
            robots: seat.newcomer.robots,
            leases: leases(*id) as u32,
            episodes: seat.episodes,
            falls: seat.falls,
            realtime_factor: seat.beat.realtime_factor,
            policy_version: seat.beat.policy_version,
            last_seen_secs: now - seat.seen_at,
            qp: seat.beat.qp,
        };
        self.seats.iter().map(row).collect()
    }

    /// Solver figures over all actors: sums, and the worst quantiles among them.
    pub(super) fn qp(&self) -> Qp {
        self.seats.values().fold(Qp::default(), |all, seat| Qp {
            solves: all.solves + seat.beat.qp.solves,
            failures: all.failures + seat.beat.qp.failures,
            p50_micros: all.p50_micros.max(seat.beat.qp.p50_micros),
            p99_micros: all.p99_micros.max(seat.beat.qp.p99_micros),
        })
    }
}
