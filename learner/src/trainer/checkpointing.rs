//! Saving all that a run is, and taking it up again to the bit.
//!
//! A checkpoint holds what cannot be read off the journal cheaply: networks, moments, counters, the policies that leases
//! may still name. Replay memory, commits and evaluations are read from the journal. What the journal holds beyond the
//! checkpoint is lived through again, updates included.

use super::seats::Seats;
use super::tally::{Meter, Tally};
use super::{Checkpointed, Error, Trainer};
use crate::history::checkpoint::{self, Checkpoint};
use crate::history::commits::Commits;
use crate::history::epoch::Epoch;
use crate::history::journal::Journal;
use crate::history::ledger::{Ledger, Rules};
use crate::history::record::Record;
use crate::metrics::Lines;
use crate::replay::Replay;
use crate::run::new_ddpg;
use crate::run_dir::{RunDir, write_whole};
use crate::shelf::Shelf;
use herd_common::config::Config;
use herd_common::policy::{Policy, Provenance};
use herd_common::seed::Seed;
use herd_common::spaces::OBSERVATION_DIM;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::watch;

/// The part of a checkpoint that only the trainer reads.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Memo {
    /// Journal records that the checkpoint includes.
    records: u64,
    metrics_bytes: u64,
    evaluations_bytes: u64,
    counters: crate::ddpg::Counters,
    tally: Tally,
}
