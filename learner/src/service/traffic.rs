//! Counts the bytes of all connections.

use herd_common::status;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Bytes since the learner was started.
#[derive(Debug, Default)]
pub struct Traffic {
    received: AtomicU64,
    sent: AtomicU64,
}

impl Traffic {
    /// Counts what came in.
    pub(super) fn add_received(&self, bytes: usize) {
        self.received.fetch_add(bytes as u64, Relaxed);
    }

    /// Counts what went out.
    pub(super) fn add_sent(&self, bytes: usize) {
        self.sent.fetch_add(bytes as u64, Relaxed);
    }

    /// Both so far.
    pub(super) fn so_far(&self) -> status::Traffic {
        status::Traffic { received_bytes: self.received.load(Relaxed), sent_bytes: self.sent.load(Relaxed) }
    }
}
