//! The journal's records as bytes: little-endian, versioned, floats by their bits.
//!
//! | field | type | holds for |
//! |---|---|---|
//! | format | u8 | all, [`FORMAT`] |
//! | kind | u8 | 1 episode, 2 evaluation |
//! | episode, version | u64, u64 | episode |
//! | sigma | f32 | episode |
//! | outcome | 113 bytes | episode |
//! | observation_dim, action_dim, n | u32, u32, u32 | episode |
//! | columns of `transition::Batch` in the order of its fields | f32 × n × width | episode |
//! | version, n, outcomes | u64, u32, 113 bytes each | evaluation |
//!
//! A value has one encoding and an encoding has one value. Decoding trusts nothing: a length is compared with the bytes
//! that are there before anything is allocated. What the numbers mean is not judged here; the ledger did that.

use herd_common::caps;
use herd_common::episode::{Counts, Ending, Fall, Outcome, Reward};
use herd_common::transition::Batch;

/// Layout of a record; it changes with every change of the table above.
pub const FORMAT: u8 = 2;

const EPISODE: u8 = 1;
const EVALUATION: u8 = 2;
const OUTCOME_BYTES: usize = 1 + 8 + 8 + 4 * 8 + 3 * 8 + 5 * 8;
/// Wider observations and actions than any task has.
const OBSERVATION_DIM_MAX: usize = 1024;
const ACTION_DIM_MAX: usize = 64;

/// An episode that is part of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Committed {
    /// Its number.
    pub episode: u64,
    /// The policy that acted.
    pub version: u64,
    /// Standard deviation of its exploration noise, in units of the action box's half width.
    pub sigma: f32,
    /// How it ended and what it was worth.
    pub outcome: Outcome,
    /// What is learnt from it.
    pub transitions: Batch,
}

/// One entry of the journal.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly every record is an episode, so a box would only cost")]
pub enum Record {
    /// A commit.
    Episode(Committed),
    /// An evaluation that is over.
    Evaluation {
        /// The policy that was on trial.
        version: u64,
        /// One outcome an episode, by index.
        outcomes: Vec<Outcome>,
    },
}

/// Why bytes are not a record.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// It ends too early.
    #[error("record ends inside {what}: {found} bytes left, expected {expected}")]
    Short {
        /// The field that is cut.
        what: &'static str,
        /// Bytes left.
        found: usize,
        /// Bytes that belong there.
        expected: usize,
    },
    /// It goes on after its end.
    #[error("record has {0} bytes after its end, expected none")]
    Trailing(usize),
    /// A field holds a value without a meaning.
    #[error("record has {what} {found}, expected {expected}")]
    Field {
        /// Which field.
        what: &'static str,
        /// Its value.
        found: u64,
        /// What it may hold.
        expected: &'static str,
    },
}

impl Record {
    /// Appends the record's bytes to `bytes`.
    pub fn encode(&self, bytes: &mut Vec<u8>) {
        bytes.push(FORMAT);
        match self {
            Self::Episode(committed) => {
                bytes.push(EPISODE);
                encode_committed(committed, bytes);
            }
            Self::Evaluation { version, outcomes } => {
                bytes.push(EVALUATION);
                bytes.extend_from_slice(&version.to_le_bytes());
                bytes.extend_from_slice(&(outcomes.len() as u32).to_le_bytes());
                for outcome in outcomes {
                    encode_outcome(outcome, bytes);
                }
            }
        }
    }

    /// The record in `bytes`, all of which it must fill.
    pub fn decode(bytes: &[u8]) -> Result<Self, Error> {
        let mut reader = Reader { rest: bytes };
        let format = reader.u8("format")?;
        if format != FORMAT {
            return Err(Error::Field { what: "format", found: format.into(), expected: "2" });
        }
        let record = match reader.u8("kind")? {
            EPISODE => Self::Episode(decode_committed(&mut reader)?),
            EVALUATION => decode_evaluation(&mut reader)?,
            kind => return Err(Error::Field { what: "kind", found: kind.into(), expected: "1 or 2" }),
        };
        if reader.rest.is_empty() { Ok(record) } else { Err(Error::Trailing(reader.rest.len())) }
    }
}

fn encode_committed(committed: &Committed, bytes: &mut Vec<u8>) {
    let Committed { episode, version, sigma, outcome, transitions } = committed;
    bytes.extend_from_slice(&episode.to_le_bytes());
    bytes.extend_from_slice(&version.to_le_bytes());
    bytes.extend_from_slice(&sigma.to_le_bytes());
    encode_outcome(outcome, bytes);
    for count in [transitions.observation_dim, transitions.action_dim, transitions.len()] {
        bytes.extend_from_slice(&(count as u32).to_le_bytes());
    }
    let Batch { observation_dim: _, action_dim: _, observations, actions, rewards, discounts, next_observations } =
        transitions;
    for column in [observations, actions, rewards, discounts, next_observations] {
        encode_floats(column, bytes);
    }
}

fn decode_committed(reader: &mut Reader<'_>) -> Result<Committed, Error> {
    let episode = reader.u64("episode")?;
    let version = reader.u64("version")?;
    let sigma = reader.f32("sigma")?;
    let outcome = decode_outcome(reader)?;
    let observation_dim = reader.count("observation length", OBSERVATION_DIM_MAX, "at most 1024")?;
    let action_dim = reader.count("action length", ACTION_DIM_MAX, "at most 64")?;
    let n = reader.count("number of transitions", caps::TRANSITIONS_PER_EPISODE, "at most 10000")?;
    let transitions = Batch {
        observation_dim,
        action_dim,
        observations: reader.floats("observations", n * observation_dim)?,
        actions: reader.floats("actions", n * action_dim)?,
        rewards: reader.floats("rewards", n)?,
        discounts: reader.floats("discounts", n)?,
        next_observations: reader.floats("next observations", n * observation_dim)?,
    };
    Ok(Committed { episode, version, sigma, outcome, transitions })
}

fn decode_evaluation(reader: &mut Reader<'_>) -> Result<Record, Error> {
    let version = reader.u64("version")?;
    let n = reader.count("number of outcomes", u32::MAX as usize, "fewer")?;
    let expected = n * OUTCOME_BYTES;
    if reader.rest.len() < expected {
        return Err(Error::Short { what: "outcomes", found: reader.rest.len(), expected });
    }
    let outcomes = (0..n).map(|_| decode_outcome(reader)).collect::<Result<_, _>>()?;
    Ok(Record::Evaluation { version, outcomes })
}

fn encode_outcome(outcome: &Outcome, bytes: &mut Vec<u8>) {
    let Outcome { ending, decisions, seconds, reward, distance_m, roll_variance, pitch_variance, counts } = outcome;
    let Reward { velocity, survival, heading, effort } = reward;
    let Counts { qp_solves, qp_failures, early_contacts, late_contacts, saturated_torques } = counts;
    bytes.push(ending_code(*ending));
    bytes.extend_from_slice(&decisions.to_le_bytes());
    for number in [seconds, velocity, survival, heading, effort, distance_m, roll_variance, pitch_variance] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    for count in [qp_solves, qp_failures, early_contacts, late_contacts, saturated_torques] {
        bytes.extend_from_slice(&count.to_le_bytes());
    }
}

fn decode_outcome(reader: &mut Reader<'_>) -> Result<Outcome, Error> {
    let code = reader.u8("ending")?;
    let ending = Ending::ALL.iter().map(|(ending, _)| *ending).find(|ending| ending_code(*ending) == code);
    let ending = ending.ok_or(Error::Field { what: "ending", found: code.into(), expected: "0 to 7" })?;
    Ok(Outcome {
        ending,
        decisions: reader.u64("decisions")?,
        seconds: reader.f64("seconds")?,
        reward: Reward {
            velocity: reader.f64("velocity reward")?,
            survival: reader.f64("survival reward")?,
            heading: reader.f64("heading reward")?,
            effort: reader.f64("effort reward")?,
        },
        distance_m: reader.f64("distance")?,
        roll_variance: reader.f64("roll variance")?,
        pitch_variance: reader.f64("pitch variance")?,
        counts: Counts {
            qp_solves: reader.u64("solves")?,
            qp_failures: reader.u64("failures")?,
            early_contacts: reader.u64("early contacts")?,
            late_contacts: reader.u64("late contacts")?,
            saturated_torques: reader.u64("saturated torques")?,
        },
    })
}

/// The number of an ending on disk. It never changes, whatever order the enum takes.
fn ending_code(ending: Ending) -> u8 {
    match ending {
        Ending::TimedOut => 0,
        Ending::Fell(Fall::Roll) => 1,
        Ending::Fell(Fall::Pitch) => 2,
        Ending::Fell(Fall::Yaw) => 3,
        Ending::Fell(Fall::Height) => 4,
        Ending::Fell(Fall::TrunkContact) => 5,
        Ending::Fell(Fall::KneeContact) => 6,
        Ending::Diverged => 7,
    }
}

/// Appends numbers by their bits.
pub(super) fn encode_floats(numbers: &[f32], bytes: &mut Vec<u8>) {
    let start = bytes.len();
    bytes.resize(start + numbers.len() * 4, 0);
    for (four, number) in bytes[start..].as_chunks_mut().0.iter_mut().zip(numbers) {
        *four = number.to_le_bytes();
    }
}

/// The numbers in `bytes`, four bytes each.
pub(super) fn decode_floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|chunk| f32::from_le_bytes(*chunk)).collect()
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, what: &'static str, expected: usize) -> Result<&'a [u8], Error> {
        let found = self.rest.len();
        let (head, rest) = self.rest.split_at_checked(expected).ok_or(Error::Short { what, found, expected })?;
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], Error> {
        let found = self.rest.len();
        let (head, rest) = self.rest.split_first_chunk().ok_or(Error::Short { what, found, expected: N })?;
        self.rest = rest;
        Ok(*head)
    }

    fn u8(&mut self, what: &'static str) -> Result<u8, Error> {
        self.array(what).map(|[byte]| byte)
    }

    fn u64(&mut self, what: &'static str) -> Result<u64, Error> {
        self.array(what).map(u64::from_le_bytes)
    }

    fn f32(&mut self, what: &'static str) -> Result<f32, Error> {
        self.array(what).map(f32::from_le_bytes)
    }

    fn f64(&mut self, what: &'static str) -> Result<f64, Error> {
        self.array(what).map(f64::from_le_bytes)
    }

    fn count(&mut self, what: &'static str, most: usize, expected: &'static str) -> Result<usize, Error> {
        let found = u32::from_le_bytes(self.array(what)?);
        if found as usize > most {
            return Err(Error::Field { what, found: found.into(), expected });
        }
        Ok(found as usize)
    }

    fn floats(&mut self, what: &'static str, count: usize) -> Result<Vec<f32>, Error> {
        self.take(what, count * 4).map(decode_floats)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any outcome, numbers by arbitrary bits.
    fn outcome() -> impl Strategy<Value = Outcome> {
        (0..8_usize, prop::array::uniform8(any::<u64>()), prop::array::uniform6(any::<u64>())).prop_map(|(e, f, u)| {
            let [seconds, velocity, survival, heading, effort, distance_m, roll_variance, pitch_variance] =
                f.map(f64::from_bits);
            let [decisions, qp_solves, qp_failures, early_contacts, late_contacts, saturated_torques] = u;
            Outcome {
                ending: Ending::ALL[e].0,
                decisions,
                seconds,
                reward: Reward { velocity, survival, heading, effort },
                distance_m,
                roll_variance,
                pitch_variance,
                counts: Counts { qp_solves, qp_failures, early_contacts, late_contacts, saturated_torques },
            }
        })
    }

    /// Any record, NaN and infinities included.
    pub(in super::super) fn record() -> impl Strategy<Value = Record> {
        let floats = |n| prop::collection::vec(any::<u32>().prop_map(f32::from_bits), n);
        let batch = (0..5_usize, 0..13_usize, 0..60_usize).prop_flat_map(move |(n, action_dim, observation_dim)| {
            let columns = (
                floats(n * observation_dim),
                floats(n * action_dim),
                floats(n),
                floats(n),
                floats(n * observation_dim),
            );
            columns.prop_map(move |(observations, actions, rewards, discounts, next_observations)| Batch {
                observation_dim,
                action_dim,
                observations,
                actions,
                rewards,
                discounts,
                next_observations,
            })
        });
        let episode = (any::<u64>(), any::<u64>(), any::<u32>(), outcome(), batch).prop_map(
            |(episode, version, sigma, outcome, transitions)| {
                let sigma = f32::from_bits(sigma);
                Record::Episode(Committed { episode, version, sigma, outcome, transitions })
            },
        );
        let evaluation = (any::<u64>(), prop::collection::vec(outcome(), 0..4))
            .prop_map(|(version, outcomes)| Record::Evaluation { version, outcomes });
        prop_oneof![3 => episode, 1 => evaluation]
    }

    pub(in super::super) fn bytes_of(record: &Record) -> Vec<u8> {
        let mut bytes = Vec::new();
        record.encode(&mut bytes);
        bytes
    }

    proptest! {
        #[test]
        fn a_record_comes_back_bit_by_bit(record in record()) {
            let bytes = bytes_of(&record);
            let back = Record::decode(&bytes).expect("decodes");
            // NaN differs from itself, so values are compared by what is printed and by their bytes.
            prop_assert_eq!(format!("{back:?}"), format!("{record:?}"));
            prop_assert_eq!(bytes_of(&back), bytes);
        }

        #[test]
        fn a_record_cut_anywhere_is_refused(record in record()) {
            let bytes = bytes_of(&record);
            for end in 0..bytes.len() {
                prop_assert!(Record::decode(&bytes[..end]).is_err(), "cut at {}", end);
            }
            prop_assert_eq!(Record::decode(&[&bytes[..], &[0]].concat()), Err(Error::Trailing(1)));
        }

        #[test]
        fn a_flipped_bit_is_refused_or_seen(record in record(), at in any::<prop::sample::Index>(), bit in 0_u8..8) {
            let mut bytes = bytes_of(&record);
            let at = at.index(bytes.len());
            bytes[at] ^= 1_u8 << bit;
            if let Ok(other) = Record::decode(&bytes) {
                prop_assert_eq!(bytes_of(&other), bytes);
            }
        }

        #[test]
        fn noise_never_panics(kind in 0_u8..4, noise in prop::collection::vec(any::<u8>(), 0..600)) {
            let bytes = [&[FORMAT, kind][..], &noise].concat();
            if let Ok(record) = Record::decode(&bytes) {
                prop_assert_eq!(bytes_of(&record), bytes);
            }
        }
    }

    #[test]
    fn the_layout_is_pinned() {
        let outcome = Outcome {
            ending: Ending::Fell(Fall::Yaw),
            decisions: 0,
            seconds: 1.5,
            reward: Reward::default(),
            distance_m: 0.0,
            roll_variance: 0.0,
            pitch_variance: 0.0,
            counts: Counts::default(),
        };
        let bytes = bytes_of(&Record::Evaluation { version: 258, outcomes: vec![outcome] });
        assert_eq!(bytes.len(), 2 + 8 + 4 + OUTCOME_BYTES);
        assert_eq!(bytes[..15], [2, 2, 2, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 3]);
        assert_eq!(bytes[23..31], 1.5_f64.to_le_bytes());
    }

    #[test]
    fn a_huge_count_is_refused_before_anything_is_allocated() {
        let mut bytes = bytes_of(&Record::Evaluation { version: 0, outcomes: Vec::new() });
        bytes[10..14].fill(0xff);
        let error = Record::decode(&bytes).expect_err("refused");
        assert_eq!(error.to_string(), "record ends inside outcomes: 0 bytes left, expected 485331304335");
    }
}
