//! The journal: every commit and evaluation of a run, appended, checksummed and synced, in a directory of segments.
//!
//! A record counts as kept once [`Journal::sync`] has returned after its [`Journal::append`]; with
//! [`Journal::flush`] alone it survives the process but not the machine. Opening verifies every byte. What a crash left
//! half written at the end is left out and told; damage before records that were synced later is an error that
//! names file and offset. A failed sync poisons the journal: the system may have dropped the pages it could not write,
//! so nothing after it could be trusted, and only a restart, which reads back what is really there, goes on.

use super::files;
use super::record::{self, Record};
use super::replay::Replay;
use super::segment::{self, Id, RUN_BYTES, Segment, Step};
use herd_common::caps;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A segment that is this long is followed by the next.
pub const SEGMENT_BYTES: u64 = 256 << 20;
/// Appended records that may wait in memory before they are handed to the system anyway.
const BUFFER_BYTES: usize = 4 << 20;

/// A point between two records.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Position {
    /// The learner that wrote the record before it; 0 for the start.
    pub epoch: u64,
    /// Records before it.
    pub sequence: u64,
}

impl Position {
    /// Before the first record.
    pub const START: Self = Self { epoch: 0, sequence: 0 };
}

/// What opening a journal found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recovery {
    /// Whole records.
    pub records: u64,
    /// Bytes of a torn tail, which are left out from now on.
    pub torn_bytes: u64,
}

/// Why the journal cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused.
    #[error("journal: {what} {path:?}: {source}")]
    Io {
        /// What was tried.
        what: &'static str,
        /// On which file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// Bytes that were whole once.
    #[error("journal {path:?} is damaged at byte {offset}: {what}")]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// Where.
        offset: u64,
        /// What is wrong there.
        what: &'static str,
    },
    /// Written by another version of herd.
    #[error("journal {path:?} has format {found}, expected {expected}")]
    Format {
        /// Which file.
        path: PathBuf,
        /// Its format.
        found: u32,
        /// Ours.
        expected: u32,
    },
    /// The journal of another run.
    #[error("journal {path:?} belongs to run {found:?}, expected {expected:?}")]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// Its run.
        found: String,
        /// Ours.
        expected: String,
    },
    /// A whole frame around something that is not a record.
    #[error("journal {path:?}, record {sequence}: {source}")]
    Record {
        /// Which file.
        path: PathBuf,
        /// Which record.
        sequence: u64,
        /// What is wrong.
        source: record::Error,
    },
    /// A record larger than a record may be.
    #[error("journal record {0} is larger than {most} bytes", most = caps::JOURNAL_RECORD_BYTES)]
    TooLarge(u64),
    /// The name of the run does not fit into a header.
    #[error("the name of the run has {0} bytes, expected at most {RUN_BYTES}")]
    RunName(usize),
    /// A newer learner has opened this journal.
    #[error("journal {dir:?} was opened by the learner of epoch {found}, this is epoch {epoch}")]
    Fenced {
        /// Which journal.
        dir: PathBuf,
        /// The highest epoch in it.
        found: u64,
        /// Ours.
        epoch: u64,
    },
    /// A point that this journal does not have.
    #[error("journal has {records} records and none of epoch {epoch} up to {sequence}", epoch = .position.epoch, sequence = .position.sequence)]
    NoPosition {
        /// The point asked for.
        position: Position,
        /// Records that there are.
        records: u64,
    },
    /// An earlier write or sync failed.
    #[error("journal cannot be trusted since an earlier sync failed; restart the learner")]
    Poisoned,
}

impl Error {
    pub(super) fn io(what: &'static str, path: &Path, source: std::io::Error) -> Self {
        Self::Io { what, path: path.to_owned(), source }
    }
}

/// A journal open for appending.
#[derive(Debug)]
pub struct Journal {
    dir: PathBuf,
    run: String,
    epoch: u64,
    segment_bytes: u64,
    /// Where the records of each earlier epoch end, of those that still count.
    ends: Vec<Position>,
    path: PathBuf,
    file: File,
    /// Bytes of earlier segments.
    older_bytes: u64,
    /// Bytes of this segment that the system has.
    written: u64,
    /// Frames that it does not have yet.
    buffer: Vec<u8>,
    /// Sequence number of the next record.
    next: u64,
    /// Records known to be on disk.
    durable: u64,
    /// Sequence number at which this segment began.
    first: u64,
    poisoned: bool,
}

impl Journal {
    /// Opens or creates the journal of a run for the learner of this epoch (see `epoch`).
    pub fn open(dir: &Path, run: &str, epoch: u64) -> Result<(Self, Recovery), Error> {
        Self::open_sized(dir, run, epoch, SEGMENT_BYTES)
    }

    /// The same with another length of segments.
    pub fn open_sized(dir: &Path, run: &str, epoch: u64, segment_bytes: u64) -> Result<(Self, Recovery), Error> {
        if run.len() > RUN_BYTES {
            return Err(Error::RunName(run.len()));
        }
        files::create_dir(dir).and_then(|()| files::sweep(dir)).map_err(|source| Error::io("create", dir, source))?;
        let found = scan(dir, run)?;
        if let Some(newest) = found.ends.last().filter(|newest| newest.epoch >= epoch) {
            return Err(Error::Fenced { dir: dir.to_owned(), found: newest.epoch, epoch });
        }
        let next = found.recovery.records;
        let (path, file, written) = create_segment(dir, Id { epoch, first: next }, run)?;
        let journal = Self {
            dir: dir.to_owned(),
            run: run.to_owned(),
            epoch,
            segment_bytes,
            ends: found.ends,
            path,
            file,
            older_bytes: found.bytes,
            written,
            buffer: Vec::new(),
            next,
            durable: next,
            first: next,
            poisoned: false,
        };
        Ok((journal, found.recovery))
    }

    /// Appends a record in memory. After an error the record is not part of the journal.
    pub fn append(&mut self, record: &Record) -> Result<(), Error> {
        if self.poisoned {
            return Err(Error::Poisoned);
        }
        if self.written + self.buffer.len() as u64 >= self.segment_bytes && self.next > self.first {
            self.rotate()?;
        } else if self.buffer.len() >= BUFFER_BYTES {
            self.flush()?;
        }
        if !segment::frame(&mut self.buffer, self.next, self.durable, |bytes| record.encode(bytes)) {
            return Err(Error::TooLarge(self.next));
        }
        self.next += 1;
        Ok(())
    }

    /// Hands everything appended to the system: it survives the end of this process. A full disk leaves the journal as
    /// it was, so the call may be repeated when there is room.
    pub fn flush(&mut self) -> Result<(), Error> {
        if self.poisoned {
            return Err(Error::Poisoned);
        }
        if let Err(source) = self.file.write_all(&self.buffer) {
            // Part of the buffer may be in the file: take it out, so that it can be written once more.
            let rewound = self.file.set_len(self.written).and_then(|()| self.file.seek(SeekFrom::Start(self.written)));
            self.poisoned = rewound.is_err();
            return Err(Error::io("write", &self.path, source));
        }
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Puts everything appended on disk: it survives a power cut. An error is final.
    pub fn sync(&mut self) -> Result<(), Error> {
        self.flush()?;
        if self.durable < self.next {
            self.file.sync_data().map_err(|source| {
                self.poisoned = true;
                Error::io("sync", &self.path, source)
            })?;
            self.durable = self.next;
        }
        Ok(())
    }

    /// The point after the last record appended.
    pub fn position(&self) -> Position {
        Position { epoch: self.epoch, sequence: self.next }
    }

    /// Records known to be on disk.
    pub fn durable(&self) -> u64 {
        self.durable
    }

    /// Bytes of all segments, those in memory included.
    pub fn bytes(&self) -> u64 {
        self.older_bytes + self.written + self.buffer.len() as u64
    }

    /// True when the records before `position` are those that its epoch wrote or read: a checkpoint of a learner that
    /// was fenced may stand at a point that never became part of the journal.
    pub fn holds(&self, position: Position) -> bool {
        let within = |end: &Position| end.epoch == position.epoch && position.sequence <= end.sequence;
        position == Position::START || within(&self.position()) || self.ends.iter().any(within)
    }

    /// The records from `position` to the last one appended.
    pub fn replay_from(&mut self, position: Position) -> Result<Replay, Error> {
        if !self.holds(position) {
            return Err(Error::NoPosition { position, records: self.next });
        }
        self.flush()?;
        Replay::new(&self.dir, Some(&self.run), position.sequence, Some(self.next))
    }

    fn rotate(&mut self) -> Result<(), Error> {
        self.sync()?;
        let (path, file, written) = create_segment(&self.dir, Id { epoch: self.epoch, first: self.next }, &self.run)?;
        self.older_bytes += self.written;
        (self.path, self.file, self.written, self.first) = (path, file, written, self.next);
        Ok(())
    }
}

/// A new segment with its header, on disk and in the directory.
fn create_segment(dir: &Path, id: Id, run: &str) -> Result<(PathBuf, File, u64), Error> {
    let path = dir.join(id.file_name());
    let header = segment::header(id, run);
    let file = files::replace(&path, &header).map_err(|source| Error::io("create", &path, source))?;
    Ok((path, file, header.len() as u64))
}

struct Found {
    recovery: Recovery,
    ends: Vec<Position>,
    bytes: u64,
}

/// Verifies every record that counts and puts the newest segment on disk, so that nothing that is read now can vanish.
fn scan(dir: &Path, run: &str) -> Result<Found, Error> {
    let segments = segment::list(dir)?;
    let mut found = Found { recovery: Recovery { records: 0, torn_bytes: 0 }, ends: Vec::new(), bytes: 0 };
    for (i, segment) in segments.iter().enumerate() {
        let torn = scan_segment(segment, run, i + 1 == segments.len(), &mut found.recovery.records)?;
        found.recovery.torn_bytes += torn;
        found.bytes += std::fs::metadata(&segment.path).map_err(|e| Error::io("measure", &segment.path, e))?.len();
        let end = Position { epoch: segment.id.epoch, sequence: found.recovery.records };
        found.ends.pop_if(|last| last.epoch == end.epoch);
        found.ends.push(end);
    }
    if let Some(Segment { path, .. }) = segments.last() {
        File::open(path).and_then(|file| file.sync_all()).map_err(|source| Error::io("sync", path, source))?;
    }
    Ok(found)
}

/// Walks over the records of a segment that count; returns the bytes of a torn tail.
fn scan_segment(segment: &Segment, run: &str, newest: bool, records: &mut u64) -> Result<u64, Error> {
    let mut reader = segment::Reader::open(segment, Some(run))?;
    if segment.limit <= segment.id.first {
        return Ok(0);
    }
    if segment.id.first != *records {
        return Err(reader.damaged("records before this file are missing"));
    }
    while reader.next() < segment.limit {
        match reader.step()? {
            Step::Record => *records = reader.next(),
            Step::End if newest => return Ok(0),
            Step::Bad if newest => {
                let torn = reader.left();
                return if reader.was_durable()? { Err(reader.damaged("a record that was whole")) } else { Ok(torn) };
            }
            Step::End => return Err(reader.damaged("records are missing at its end")),
            Step::Bad => return Err(reader.damaged("a record that was whole")),
        }
    }
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;

    fn journal_on(device: &str) -> (tempfile::TempDir, Journal) {
        let dir = tempfile::tempdir().expect("directory");
        let (mut journal, _) = Journal::open(dir.path(), "run", 1).expect("opened");
        journal.file = OpenOptions::new().write(true).open(device).expect("device");
        (dir, journal)
    }

    fn record() -> Record {
        Record::Evaluation { version: 3, outcomes: Vec::new() }
    }

    #[test]
    fn a_failed_sync_is_final() {
        // This device takes every byte and cannot be synced.
        let (_dir, mut journal) = journal_on("/dev/null");
        journal.append(&record()).expect("in memory");
        assert!(journal.sync().expect_err("not synced").to_string().starts_with("journal: sync"));
        assert_eq!(journal.durable(), 0);
        for result in [journal.append(&record()), journal.flush(), journal.sync()] {
            assert!(matches!(result, Err(Error::Poisoned)), "{result:?}");
        }
        assert!(journal.replay_from(Position::START).is_err());
    }

    #[test]
    fn a_failed_write_that_cannot_be_taken_back_is_final() {
        // This device is always full and cannot be cut.
        let (_dir, mut journal) = journal_on("/dev/full");
        journal.append(&record()).expect("in memory");
        assert!(journal.sync().expect_err("full").to_string().starts_with("journal: write"));
        assert!(matches!(journal.sync(), Err(Error::Poisoned)));
    }

    #[test]
    fn nothing_to_sync_is_no_sync() {
        let (_dir, mut journal) = journal_on("/dev/null");
        journal.sync().expect("nothing to do");
    }
}
