//! Questions out and answers in, a JSON line each; what goes wrong is kept until somebody asks.

use crate::out;
use herd_actor::sim::{Ask, Snapshot};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::io::{BufRead, Read};
use std::sync::{Arc, Mutex, PoisonError};

/// Longest answer, bytes: ten times what a state takes.
const LONGEST: u64 = 16 * 1024;

/// The two pipes, shared by whoever asks.
#[derive(Clone, Debug, Default)]
pub(super) struct Lines {
    broken: Arc<Mutex<Option<String>>>,
}

/// An answer to `observe`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    action: Vec<f32>,
}

impl Lines {
    /// The robot after what was asked; none once anything went wrong.
    pub(super) fn state(&self, ask: &Ask) -> Option<Snapshot> {
        let snapshot: Snapshot = self.ask(ask)?;
        if snapshot.state().is_finite() && snapshot.contacts().normal.iter().all(|force| force.is_finite()) {
            return Some(snapshot);
        }
        self.fail("a state has a number that is not finite".to_owned())
    }

    /// The action of length `dim` for this observation; none once anything went wrong.
    pub(super) fn action(&self, observation: &[f32], dim: usize) -> Option<Vec<f32>> {
        let Answer { action } = self.ask(&serde_json::json!({ "observe": observation }))?;
        if action.len() == dim && action.iter().all(|x| x.is_finite()) {
            return Some(action);
        }
        self.fail(format!("action is {action:?}, expected {dim} finite numbers"))
    }

    /// Says something that needs no answer.
    #[expect(clippy::unused_self, reason = "whoever speaks holds the lines")]
    pub(super) fn say(&self, what: &impl Serialize) -> anyhow::Result<()> {
        out::json(what)
    }

    /// The first thing that went wrong.
    pub(super) fn broken(&self) -> Option<String> {
        self.broken.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn ask<T: DeserializeOwned>(&self, question: &impl Serialize) -> Option<T> {
        if self.broken().is_some() {
            return None;
        }
        if let Err(error) = out::json(question) {
            return self.fail(format!("write to stdout: {error}"));
        }
        match answer(&mut std::io::stdin().lock()) {
            Ok(answer) => Some(answer),
            Err(why) => self.fail(why),
        }
    }

    fn fail<T>(&self, why: String) -> Option<T> {
        self.broken.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
        None
    }
}

/// The next line, as what is expected.
fn answer<T: DeserializeOwned>(input: &mut impl BufRead) -> Result<T, String> {
    let mut line = String::new();
    input.take(LONGEST).read_line(&mut line).map_err(|e| format!("read stdin: {e}"))?;
    if line.is_empty() {
        return Err("stdin ended before the episode did".to_owned());
    }
    serde_json::from_str(&line).map_err(|e| format!("answer {:?}: {e}", line.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_answers_are_named() {
        let refused = |text: &str, expected: &str| {
            let error = answer::<Answer>(&mut text.as_bytes()).expect_err("refused");
            assert!(error.contains(expected), "{error}");
        };
        refused("", "stdin ended");
        refused("{\"act\":[1]}\n", "act");
        refused("walk\n", "walk");
        refused(&format!("{{\"action\":[{}1]}}\n", " ".repeat(LONGEST as usize)), "EOF");
        assert_eq!(answer::<Answer>(&mut &b"{\"action\":[0.5]}\n"[..]).expect("fine").action, [0.5]);
    }
}
