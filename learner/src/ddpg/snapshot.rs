//! A learner as plain data: everything but configuration, seed and replay memory that its next update depends on.
//!
//! Tensors come in a fixed order and are named `{network}.{row}.{layer}.{weight or bias}`: network `actor`, `critic0` or
//! `critic1`; row `online`, `target`, `mean` or `square` (Adam's moments). A weight is `[inputs, outputs]`. Prioritised
//! replay adds two tensors, see `priorities`.

use super::error::Error;
use super::networks::Network;
use super::priorities::Priorities;
use super::rows::{Row, Span};
use super::update::Ddpg;
use herd_common::policy::Layer;
use serde::{Deserialize, Serialize};

/// One tensor of a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Its name, as in the module's description.
    pub name: String,
    /// Lengths of its dimensions.
    pub shape: Vec<usize>,
    /// Its numbers, the last dimension fastest.
    pub values: Vec<f32>,
}

/// The numbers of a learner that are not tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counters {
    /// Updates, skipped ones included; also the number of the next update's branch of the seed tree.
    pub updates: u64,
    /// Updates skipped.
    pub skipped: u64,
    /// Updates skipped since the last that was not.
    pub skipped_in_row: u32,
    /// Adam's steps of the critics.
    pub critic_steps: u64,
    /// Adam's steps of the actor.
    pub actor_steps: u64,
    /// Transitions that prioritised replay has seen; 0 without it.
    #[serde(default)]
    pub prioritised: u64,
}

/// A learner as plain data.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// What is not a tensor.
    pub counters: Counters,
    /// What is.
    pub records: Vec<Record>,
}

/// A network's weights and biases in order, input first.
pub(super) trait Spanned {
    /// Where they stand in a row.
    fn spans(&self) -> &[Span];
}

/// A network that can be read, wherever its tensors were.
pub(super) trait Stored: Spanned {
    /// The numbers of one weight or bias.
    fn read(&self, row: Row, span: &Span) -> Vec<f32>;
}

impl Spanned for Network {
    fn spans(&self) -> &[Span] {
        Self::spans(self)
    }
}

impl Stored for Network {
    fn read(&self, row: Row, span: &Span) -> Vec<f32> {
        Self::read(self, row, span)
    }
}

/// The networks of a learner with their names in snapshots.
pub(super) fn named<'a, N>(actor: &'a N, critics: &'a [N]) -> impl Iterator<Item = (String, &'a N)> {
    let critics = critics.iter().enumerate().map(|(i, critic)| (format!("critic{i}"), critic));
    std::iter::once(("actor".to_owned(), actor)).chain(critics)
}

/// All that a learner of these parts depends on.
pub(super) fn save<'a, N: Stored + 'a>(
    networks: impl Iterator<Item = (String, &'a N)>,
    priorities: Option<&Priorities>,
    mut counters: Counters,
) -> Snapshot {
    let mut records = Vec::new();
    for (name, network) in networks {
        for row in Row::LASTING {
            for span in network.spans() {
                let name = format!("{name}.{}.{}", row.name(), span.name);
                records.push(Record { name, shape: span.shape.clone(), values: network.read(row, span) });
            }
        }
    }
    if let Some(priorities) = priorities {
        records.extend(priorities.save());
        counters.prioritised = priorities.seen();
    }
    Snapshot { counters, records }
}

/// What a snapshot holds for a learner of these parts: each network's lasting rows one after the other, and priorities.
pub(super) fn parts<'a, N: Spanned + 'a>(
    snapshot: &Snapshot,
    networks: impl Iterator<Item = (String, &'a N)>,
    priorities: Option<&Priorities>,
) -> Result<(Vec<Vec<f32>>, Option<Priorities>), Error> {
    let mut records = snapshot.records.iter();
    let mut arenas = Vec::new();
    for (name, network) in networks {
        let mut numbers = Vec::new();
        for row in Row::LASTING {
            for span in network.spans() {
                let name = format!("{name}.{}.{}", row.name(), span.name);
                numbers.extend_from_slice(expect(records.next(), &name, &span.shape)?);
            }
        }
        arenas.push(numbers);
    }
    let priorities = match priorities {
        None => None,
        Some(priorities) => {
            let missing = || Error::Snapshot { found: "no more tensors".into(), expected: "priorities".into() };
            let [surprises, largest] = [records.next(), records.next()].map(|record| record.ok_or_else(missing));
            Some(priorities.load(snapshot.counters.prioritised, surprises?, largest?)?)
        }
    };
    if let Some(extra) = records.next() {
        return Err(Error::Snapshot { found: describe(&extra.name, &extra.shape), expected: "no more tensors".into() });
    }
    Ok((arenas, priorities))
}

/// An actor as plain data, every number finite.
pub(super) fn policy_layers(actor: &impl Stored) -> Result<Vec<Layer>, Error> {
    let layer = |pair: &[Span]| -> Result<Layer, Error> {
        let (inputs, outputs) = (pair[0].shape[0], pair[0].shape[1]);
        let [weights, biases] = [&pair[0], &pair[1]].map(|span| actor.read(Row::Online, span));
        check_finite(&format!("actor.{}", pair[0].name), &weights)?;
        check_finite(&format!("actor.{}", pair[1].name), &biases)?;
        Ok(Layer { inputs, outputs, weights, biases })
    };
    actor.spans().chunks_exact(2).map(layer).collect()
}

impl Ddpg {
    /// All that the next update depends on, but for configuration, seed and replay memory.
    pub fn save(&self) -> Result<Snapshot, Error> {
        Ok(save(named(&self.actor, &self.critics), self.priorities.as_ref(), self.counters))
    }

    /// Goes on where `snapshot` was taken. On an error nothing has changed.
    pub fn load(&mut self, snapshot: &Snapshot) -> Result<(), Error> {
        let networks = named(&self.actor, &self.critics);
        let (arenas, priorities) = parts(snapshot, networks, self.priorities.as_ref())?;
        for (network, numbers) in std::iter::once(&mut self.actor).chain(&mut self.critics).zip(arenas) {
            network.overwrite(&numbers);
        }
        self.counters = snapshot.counters;
        self.priorities = priorities;
        Ok(())
    }
}

/// Refuses numbers that are not finite.
pub(super) fn check_finite(record: &str, values: &[f32]) -> Result<(), Error> {
    match values.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(index) => Err(Error::NotFinite { record: record.into(), index, value: values[index] }),
    }
}

fn expect<'a>(record: Option<&'a Record>, name: &str, shape: &[usize]) -> Result<&'a [f32], Error> {
    let expected = || describe(name, shape);
    let Some(record) = record else {
        return Err(Error::Snapshot { found: "no more tensors".into(), expected: expected() });
    };
    let fits = record.values.len() == shape.iter().product::<usize>();
    if record.name != name || record.shape != shape || !fits {
        let found = format!("{} with {} numbers", describe(&record.name, &record.shape), record.values.len());
        return Err(Error::Snapshot { found, expected: expected() });
    }
    check_finite(name, &record.values)?;
    Ok(&record.values)
}

fn describe(name: &str, shape: &[usize]) -> String {
    format!("tensor {name} {shape:?}")
}
