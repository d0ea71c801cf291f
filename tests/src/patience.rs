//! Waiting for what other processes do: looks again and again until a deadline, so that nothing depends on a guess of
//! how long something takes.

use std::time::{Duration, Instant};

/// Long enough for a whole small run on a busy machine; reaching it is a failure.
pub const LONG: Duration = Duration::from_secs(120);
/// Long enough for anything that should happen at once.
pub const SHORT: Duration = Duration::from_secs(30);

const BETWEEN_LOOKS: Duration = Duration::from_millis(10);

/// Looks until there is something to see, which it returns; fails after `limit`, naming `what` was awaited.
#[track_caller]
pub fn eventually<T>(limit: Duration, what: &str, look: impl FnMut() -> Option<T>) -> T {
    within(limit, look).unwrap_or_else(|| panic!("{what}: not within {limit:?}"))
}

/// Looks until there is something to see; `None` after `limit`.
#[expect(clippy::disallowed_methods, reason = "the one clock of the tests: a deadline against hanging")]
pub fn within<T>(limit: Duration, mut look: impl FnMut() -> Option<T>) -> Option<T> {
    let deadline = Instant::now() + limit;
    loop {
        let seen = look();
        if seen.is_some() || Instant::now() > deadline {
            return seen;
        }
        std::thread::sleep(BETWEEN_LOOKS);
    }
}
