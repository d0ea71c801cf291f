//! The durable history of a run: who runs which episode, what is committed, and how that survives a crash.
//!
//! `ledger` decides, `journal` keeps what was decided, `checkpoint` shortens the way back, `epoch` makes sure that
//! one learner at a time writes. The ledger does no I/O and knows no clock; the others touch their directory only.

pub mod checkpoint;
pub mod commits;
pub mod epoch;
pub mod journal;
pub mod lease;
pub mod ledger;
pub mod record;
pub mod refusal;
pub mod replay;

mod files;
mod holders;
mod segment;

#[cfg(test)]
mod journal_crash;
#[cfg(test)]
mod ledger_chaos;
