//! Crashes against the journal: cuts at every byte, flipped bits, missing and foreign files, a fenced learner.

use super::journal::{Error, Journal, Position, Recovery};
use super::record::tests::{bytes_of, record};
use super::record::{Committed, Record};
use super::replay;
use herd_common::episode::{Counts, Ending, Outcome, Reward};
use herd_common::spaces::{OBSERVATION_DIM, Task};
use herd_common::transition::{Batch, Transition};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The record of episode `n`, a bit different for each.
fn episode(n: u64) -> Record {
    let mut transitions = Batch::new(Task::Gait.dims());
    for i in 0..n % 3 {
        transitions.push(Transition {
            observation: &[n as f32 / 100.0; OBSERVATION_DIM],
            action: &[0.5; 4],
            reward: i as f32,
            discount: 0.95,
            next_observation: &[-0.5; OBSERVATION_DIM],
        });
    }
    let outcome = Outcome {
        ending: Ending::TimedOut,
        decisions: n % 3,
        seconds: n as f64,
        reward: Reward::default(),
        distance_m: 0.0,
        roll_variance: 0.0,
        pitch_variance: 0.0,
        counts: Counts::default(),
    };
    Record::Episode(Committed { episode: n, version: n / 2, sigma: 0.25, outcome, transitions })
}

fn open(dir: &Path, epoch: u64) -> Result<(Journal, Recovery), Error> {
    Journal::open_sized(dir, "run", epoch, 2000)
}

fn fill(journal: &mut Journal, episodes: std::ops::Range<u64>) {
    for n in episodes {
        journal.append(&episode(n)).expect("appended");
        journal.sync().expect("synced");
    }
}

/// A journal of the episodes `0..n`, each synced, in several segments of one learner.
fn journal_of(n: u64) -> TempDir {
    let dir = tempfile::tempdir().expect("directory");
    fill(&mut open(dir.path(), 1).expect("opened").0, 0..n);
    dir
}

fn read_all(dir: &Path) -> Vec<Record> {
    replay::read(dir).expect("opened").map(|record| record.expect("whole")).collect()
}

fn segments(dir: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(dir).expect("listed").map(|entry| entry.expect("entry").path()).collect();
    paths.sort();
    paths
}

fn copy(dir: &Path) -> TempDir {
    let copy = tempfile::tempdir().expect("directory");
    for path in segments(dir) {
        std::fs::copy(&path, copy.path().join(path.file_name().expect("named"))).expect("copied");
    }
    copy
}

fn episodes(n: u64) -> Vec<Record> {
    (0..n).map(episode).collect()
}

/// What a journal opened by the next learner holds, and that it goes on from there.
#[track_caller]
fn check_goes_on(dir: &Path, epoch: u64, records: u64) -> Recovery {
    let (mut journal, recovery) = open(dir, epoch).expect("opened");
    assert_eq!(recovery.records, records);
    (records..records + 3).for_each(|n| journal.append(&episode(n)).expect("appended"));
    let all: Vec<Record> = journal.replay_from(Position::START).expect("held").map(|r| r.expect("whole")).collect();
    assert_eq!(all, episodes(records + 3));
    assert_eq!(read_all(dir), all, "two ways to read");
    recovery
}

#[test]
fn it_is_read_back_over_segments_and_restarts() {
    let dir = journal_of(20);
    assert!(segments(dir.path()).len() > 3, "several segments");
    for (epoch, records) in [(2, 20), (5, 23), (6, 26)] {
        let recovery = check_goes_on(dir.path(), epoch, records);
        assert_eq!(recovery.torn_bytes, 0);
    }
    let (mut journal, _) = open(dir.path(), 7).expect("opened");
    for sequence in 0..=29 {
        let position = Position { epoch: 6, sequence };
        let rest: Vec<Record> = journal.replay_from(position).expect("held").map(|r| r.expect("whole")).collect();
        assert_eq!(rest, episodes(29)[sequence as usize..]);
    }
    let files: u64 = segments(dir.path()).iter().map(|p| p.metadata().expect("there").len()).sum();
    assert_eq!(journal.bytes(), files);
}

#[test]
fn a_tail_cut_at_every_byte_is_left_out_and_told() {
    let whole = journal_of(8);
    let last = segments(whole.path()).pop().expect("one");
    let bytes = std::fs::read(&last).expect("read");
    let header = bytes.len() - frame_lengths(&last).iter().sum::<usize>();
    let before = 8 - frame_lengths(&last).len() as u64;
    for end in header..bytes.len() {
        let dir = copy(whole.path());
        std::fs::write(dir.path().join(last.file_name().expect("named")), &bytes[..end]).expect("written");
        let mut at = header;
        let kept = frame_lengths(&last)
            .into_iter()
            .take_while(|n| {
                at += n;
                at <= end
            })
            .collect::<Vec<_>>();
        let records = before + kept.len() as u64;
        let torn_bytes = (end - header - kept.iter().sum::<usize>()) as u64;
        assert_eq!(open(dir.path(), 2).expect("opened").1, Recovery { records, torn_bytes }, "cut at {end}");
        assert_eq!(read_all(dir.path()), episodes(records));
        if end % 97 == 0 || torn_bytes == 0 {
            assert_eq!(check_goes_on(dir.path(), 3, records).torn_bytes, 0, "told once");
        }
    }
}

/// Lengths of the frames of a segment, by its own length fields.
fn frame_lengths(path: &Path) -> Vec<usize> {
    let bytes = std::fs::read(path).expect("read");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four")) as usize;
    let mut at = 36 + word(28);
    let mut lengths = Vec::new();
    while at < bytes.len() {
        lengths.push(24 + word(at));
        at += 24 + word(at);
    }
    lengths
}

#[test]
fn a_flipped_bit_before_what_was_synced_later_is_an_error_that_names_the_place() {
    let whole = journal_of(8);
    for path in segments(whole.path()) {
        let bytes = std::fs::read(&path).expect("read");
        let newest = segments(whole.path()).last() == Some(&path);
        let last_frame = bytes.len() - frame_lengths(&path).last().expect("one");
        let mut dir = copy(whole.path());
        for at in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[at] ^= 1 << (at % 8);
            let damaged = dir.path().join(path.file_name().expect("named"));
            std::fs::write(&damaged, bad).expect("written");
            match open(dir.path(), 2) {
                Err(Error::Damaged { path, offset, .. }) => {
                    assert_eq!(path, damaged);
                    assert!(offset as usize <= at, "{offset} is where the bad record begins, the flip is at {at}");
                }
                Ok((_, recovery)) => {
                    assert!(newest && at >= last_frame, "flip at {at} of {damaged:?} is not seen");
                    assert_eq!(recovery.records, 7);
                    assert_eq!(recovery.torn_bytes as usize, bytes.len() - last_frame);
                    dir = copy(whole.path());
                }
                Err(other) => panic!("flip at {at}: {other}"),
            }
        }
    }
}

#[test]
fn frames_that_were_written_together_may_be_lost_together() {
    let dir = tempfile::tempdir().expect("directory");
    let (mut journal, _) = Journal::open(dir.path(), "run", 1).expect("opened");
    fill(&mut journal, 0..2);
    (2..5).for_each(|n| journal.append(&episode(n)).expect("appended"));
    journal.flush().expect("written");
    assert_eq!((journal.durable(), journal.position().sequence), (2, 5));
    let path = segments(dir.path()).pop().expect("one");
    let lengths = frame_lengths(&path);
    let mut bytes = std::fs::read(&path).expect("read");
    let third = bytes.len() - lengths[2..].iter().sum::<usize>();
    bytes[third..third + lengths[2]].fill(0);
    std::fs::write(&path, bytes).expect("written");
    let recovery = check_goes_on(dir.path(), 2, 2);
    assert_eq!(recovery.torn_bytes as usize, lengths[2..].iter().sum::<usize>());
}

#[test]
fn a_missing_file_is_an_error() {
    let whole = journal_of(20);
    let all = segments(whole.path());
    for path in &all[..all.len() - 1] {
        let dir = copy(whole.path());
        std::fs::remove_file(dir.path().join(path.file_name().expect("named"))).expect("removed");
        assert!(matches!(open(dir.path(), 2), Err(Error::Damaged { .. })), "{path:?}");
    }
}

#[test]
fn swapped_files_are_an_error() {
    let dir = journal_of(20);
    let all = segments(dir.path());
    let aside = dir.path().join("aside");
    for (from, to) in [(&all[0], &aside), (&all[1], &all[0]), (&aside, &all[1])] {
        std::fs::rename(from, to).expect("renamed");
    }
    let error = open(dir.path(), 2).expect_err("refused").to_string();
    assert!(error.ends_with("is damaged at byte 0: the header of the file"), "{error}");
}

#[test]
fn a_foreign_or_newer_journal_is_refused() {
    let dir = journal_of(2);
    let error = Journal::open(dir.path(), "other", 2).expect_err("refused").to_string();
    assert!(error.ends_with(r#"belongs to run "run", expected "other""#), "{error}");
    assert!(matches!(open(dir.path(), 1), Err(Error::Fenced { found: 1, epoch: 1, .. })));
    let path = segments(dir.path()).pop().expect("one");
    let mut bytes = std::fs::read(&path).expect("read");
    bytes[8] = 2;
    let crc = crc32c::crc32c(&bytes[..35]);
    bytes[35..39].copy_from_slice(&crc.to_le_bytes());
    std::fs::write(&path, bytes).expect("written");
    assert!(matches!(open(dir.path(), 2), Err(Error::Format { found: 2, expected: 1, .. })));
}

#[test]
fn what_a_fenced_learner_still_writes_is_overruled() {
    let dir = tempfile::tempdir().expect("directory");
    let (mut old, _) = open(dir.path(), 1).expect("opened");
    fill(&mut old, 0..5);
    let (mut new, _) = open(dir.path(), 2).expect("opened");
    fill(&mut new, 5..7);
    for n in 100..120 {
        old.append(&episode(n)).expect("it does not know");
        old.sync().expect("it does not know");
    }
    let (fenced, current) = (old.position(), new.position());
    fill(&mut new, 7..9);
    drop((old, new));
    assert_eq!(read_all(dir.path()), episodes(9));
    let (journal, recovery) = open(dir.path(), 3).expect("opened");
    assert_eq!(recovery, Recovery { records: 9, torn_bytes: 0 });
    assert!(journal.holds(current) && !journal.holds(fenced), "nor is a checkpoint of it used");
    assert!(journal.holds(Position { epoch: 1, sequence: 5 }) && !journal.holds(Position { epoch: 1, sequence: 6 }));
    drop(journal);
    check_goes_on(dir.path(), 4, 9);
}

#[test]
fn records_that_a_checkpoint_stands_on_are_missed() {
    let dir = journal_of(4);
    let (mut journal, _) = open(dir.path(), 2).expect("opened");
    let position = Position { epoch: 1, sequence: 5 };
    let error = journal.replay_from(position).err().expect("refused").to_string();
    assert_eq!(error, "journal has 4 records and none of epoch 1 up to 5");
}

#[test]
fn a_live_journal_can_be_read() {
    let dir = tempfile::tempdir().expect("directory");
    let (mut journal, _) = open(dir.path(), 1).expect("opened");
    fill(&mut journal, 0..7);
    journal.append(&episode(7)).expect("appended");
    assert_eq!(read_all(dir.path()), episodes(7), "what is only in memory is not there yet");
    journal.flush().expect("written");
    let path = segments(dir.path()).pop().expect("one");
    let bytes = std::fs::read(&path).expect("read");
    std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("written");
    assert_eq!(read_all(dir.path()), episodes(7), "nor is half a record");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_records_come_back_whatever_the_batches(
        batches in prop::collection::vec((prop::collection::vec(record(), 0..4), any::<bool>()), 0..6),
        segment_bytes in 1_u64..4000,
        noise in prop::collection::vec(any::<u8>(), 0..100),
    ) {
        let dir = tempfile::tempdir().expect("directory");
        let mut expected = Vec::new();
        for (epoch, (records, reopen)) in batches.iter().enumerate() {
            let epoch = epoch as u64 + 1;
            let (mut journal, recovery) =
                Journal::open_sized(dir.path(), "run", epoch, segment_bytes).expect("opened");
            prop_assert_eq!(recovery.records, expected.len() as u64);
            for record in records {
                journal.append(record).expect("appended");
                expected.push(bytes_of(record));
            }
            if *reopen { journal.sync().expect("synced") } else { journal.flush().expect("written") }
            let back = journal.replay_from(Position::START).expect("held");
            prop_assert_eq!(&back.map(|r| bytes_of(&r.expect("whole"))).collect::<Vec<_>>(), &expected);
        }
        // Whatever stands behind the last record is no record.
        if let Some(path) = segments(dir.path()).pop() {
            let bytes = [std::fs::read(&path).expect("read"), noise].concat();
            std::fs::write(&path, bytes).expect("written");
            let back = replay::read(dir.path()).expect("opened");
            prop_assert_eq!(&back.map(|r| bytes_of(&r.expect("whole"))).collect::<Vec<_>>(), &expected);
            let (_, recovery) = Journal::open(dir.path(), "run", 99).expect("opened");
            prop_assert_eq!(recovery.records, expected.len() as u64);
        }
    }
}
