//! Why a message from the wire is refused.

use herd_common::{policy, transition};

/// A message that breaks the contract; the text names the field, the value and the expected.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// A field that must be there is not.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A field has a value that cannot be.
    #[error("{field} is {value}, expected {expected}")]
    Invalid {
        /// Which field.
        field: &'static str,
        /// What it holds.
        value: String,
        /// What holds.
        expected: String,
    },
    /// Transitions of wrong shape or value.
    #[error(transparent)]
    Transition(#[from] transition::Error),
    /// Not a policy.
    #[error(transparent)]
    Policy(#[from] policy::Error),
}

impl WireError {
    /// An [`WireError::Invalid`] from anything printable.
    pub fn invalid(field: &'static str, value: impl std::fmt::Display, expected: impl std::fmt::Display) -> Self {
        Self::Invalid { field, value: value.to_string(), expected: expected.to_string() }
    }
}

impl From<WireError> for tonic::Status {
    fn from(error: WireError) -> Self {
        Self::invalid_argument(error.to_string())
    }
}
