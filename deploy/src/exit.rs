//! How the process ends: one place that tells an error and chooses the exit code, after `sysexits.h`.
//!
//! | code | meaning | an engine should |
//! |---|---|---|
//! | 0 | done, or stopped when asked to | leave it |
//! | 64 | wrong usage | not restart |
//! | 70 | internal error | restart |
//! | 75 | nobody there, try again later | restart |
//! | 78 | configuration or task mismatch | not restart |

use std::process::ExitCode;

/// Wrong usage.
pub(crate) const USAGE: u8 = 64;
/// Internal error.
pub(crate) const INTERNAL: u8 = 70;
/// Try again later.
pub(crate) const RETRY: u8 = 75;
/// Configuration or task mismatch.
pub(crate) const CONFIG: u8 = 78;

/// An error of this binary's own, with its exit code.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub(crate) struct Failure {
    code: u8,
    message: String,
}

impl Failure {
    /// The user's words make no sense together.
    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self { code: USAGE, message: message.into() }
    }

    /// Trying again later can help.
    pub(crate) fn retry(message: impl Into<String>) -> Self {
        Self { code: RETRY, message: message.into() }
    }

    /// What is configured does not fit.
    pub(crate) fn config(message: impl Into<String>) -> Self {
        Self { code: CONFIG, message: message.into() }
    }

    /// A child process ended with this code.
    #[cfg(all(feature = "actor", feature = "learner"))]
    pub(crate) fn child(code: u8, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}

/// Tells what clap has to say; help and version are no errors.
pub(crate) fn usage(told: &clap::Error) -> ExitCode {
    let _ = told.print();
    ExitCode::from(if told.use_stderr() { USAGE } else { 0 })
}

/// Tells an error, causes included, and gives its exit code.
pub(crate) fn failure(error: &anyhow::Error) -> ExitCode {
    if is_broken_pipe(error) {
        return ExitCode::SUCCESS;
    }
    let chain: Vec<String> = error.chain().map(ToString::to_string).collect();
    eprintln!("error: {}", without_repetition(&chain).join(": "));
    ExitCode::from(code(error))
}

/// The exit code of the outermost cause that has one.
fn code(error: &anyhow::Error) -> u8 {
    error.chain().find_map(code_of).unwrap_or(INTERNAL)
}

fn code_of(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    use herd_proto::client;
    if let Some(failure) = cause.downcast_ref::<Failure>() {
        return Some(failure.code);
    }
    #[cfg(feature = "actor")]
    if let Some(error) = cause.downcast_ref::<herd_actor::run::Error>() {
        return error.is_config().then_some(CONFIG);
    }
    #[cfg(feature = "learner")]
    if let Some(code) = crate::wing::exit_code(cause) {
        return Some(code);
    }
    if let Some(error) = cause.downcast_ref::<client::Error>() {
        return Some(match error {
            client::Error::Address { .. } => USAGE,
            error if error.is_transient() => RETRY,
            _ => CONFIG,
        });
    }
    let is_config = cause.is::<herd_common::config::Error>() || cause.is::<herd_common::policy::Error>();
    is_config.then_some(CONFIG)
}

/// The chain without causes that the error before them already tells.
fn without_repetition(chain: &[String]) -> Vec<&str> {
    let mut told: Vec<&str> = Vec::new();
    for cause in chain {
        if told.last().is_none_or(|last| !last.contains(cause.as_str())) {
            told.push(cause);
        }
    }
    told
}

/// A reader such as `head` that has seen enough is no failure.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let kind =
        |cause: &(dyn std::error::Error + 'static)| cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
    error.chain().any(|cause| kind(cause) == Some(std::io::ErrorKind::BrokenPipe))
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;
    use herd_proto::client;

    #[track_caller]
    fn check(error: impl Into<anyhow::Error>, expected: u8) {
        let error = Err::<(), _>(error.into()).context("outer").expect_err("an error");
        assert_eq!(code(&error), expected, "{error:#}");
    }

    #[test]
    fn codes() {
        check(Failure::usage("x"), USAGE);
        check(client::Error::Unreachable { address: "a:1".into(), reason: "r".into() }, RETRY);
        check(client::Error::Address { address: "a".into(), reason: "r".into() }, USAGE);
        check(client::Error::Refused { code: tonic::Code::FailedPrecondition, message: "m".into() }, CONFIG);
        check(herd_common::config::Config::load(None, &["x=1".into()]).expect_err("refused"), CONFIG);
        check(std::io::Error::other("disk"), INTERNAL);
    }

    #[test]
    fn a_cause_is_told_once() {
        let chain = ["read a: no such file".to_owned(), "no such file".to_owned(), "deeper".to_owned()];
        assert_eq!(without_repetition(&chain), ["read a: no such file", "deeper"]);
    }
}
