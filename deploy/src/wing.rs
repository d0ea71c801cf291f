//! The learner wing as this binary uses it.

pub(crate) use herd_learner::run;

use crate::exit;

/// The exit code that an error of the learner stands for, if it is one.
pub(crate) fn exit_code(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    let error = cause.downcast_ref::<run::Error>()?;
    if error.is_config() {
        return Some(exit::CONFIG);
    }
    error.is_retry().then_some(exit::RETRY)
}

/// An error of the learner, to be told.
pub(crate) fn told(error: impl Into<run::Error>) -> anyhow::Error {
    anyhow::Error::from(error.into())
}
