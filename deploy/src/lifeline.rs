//! Ties a child's life to its parent's, so that no process of `herd train` outlives it, whatever ends it.

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// Asks the kernel for SIGTERM when the parent dies. False when there is a parent to live with and it is gone already.
pub(crate) fn hold(parent: Option<i32>) -> bool {
    let Some(parent) = parent else { return true };
    // The request first, the look second: a parent that dies between the two is then seen by one of them.
    let asked = set_parent_process_death_signal(Some(Signal::TERM));
    asked.is_ok() && getppid().map(Pid::as_raw_nonzero).map(std::num::NonZero::get) == Some(parent)
}
