//! Reads a journal's records in order, one at a time.

use super::journal::Error;
use super::record::Record;
use super::segment::{self, Reader, Segment, Step};
use std::path::Path;

/// An iterator over records. It verifies what it reads and ends after its first error.
pub struct Replay {
    run: Option<String>,
    /// Segments still to come, the next one last.
    segments: Vec<Segment>,
    current: Option<(Segment, Reader)>,
    /// Sequence number of the next record.
    next: u64,
    /// Sequence number at which to stop; `None`: at the last whole record.
    end: Option<u64>,
    failed: bool,
}

/// The records of a journal that is perhaps being written, from the first to the last whole one. It changes nothing, so
/// it serves reports and exports.
pub fn read(dir: &Path) -> Result<Replay, Error> {
    Replay::new(dir, None, 0, None)
}

impl Replay {
    pub(super) fn new(dir: &Path, run: Option<&str>, first: u64, end: Option<u64>) -> Result<Self, Error> {
        let mut segments = segment::list(dir)?;
        segments.retain(|segment| segment.limit > segment.id.first.max(first));
        segments.reverse();
        Ok(Self { run: run.map(str::to_owned), segments, current: None, next: first, end, failed: false })
    }

    /// Sequence number of the record that comes next.
    pub fn sequence(&self) -> u64 {
        self.next
    }

    fn advance(&mut self) -> Result<Option<Record>, Error> {
        loop {
            if self.end == Some(self.next) {
                return Ok(None);
            }
            let Some((segment, mut reader)) = self.current.take() else {
                let Some(segment) = self.segments.pop() else { return Ok(None) };
                let reader = Reader::open(&segment, self.run.as_deref())?;
                if segment.id.first > self.next {
                    return Err(reader.damaged("records before this file are missing"));
                }
                self.current = Some((segment, reader));
                continue;
            };
            if reader.next() >= segment.limit {
                continue;
            }
            match reader.step()? {
                Step::Record => {}
                // Whoever writes may be in the middle of a record; a reader of a live journal comes back later.
                Step::End | Step::Bad if self.end.is_none() && self.segments.is_empty() => return Ok(None),
                Step::End => return Err(reader.damaged("records are missing at its end")),
                Step::Bad => return Err(reader.damaged("a record that was whole")),
            }
            let sequence = reader.next() - 1;
            if sequence < self.next {
                self.current = Some((segment, reader));
                continue;
            }
            let record = Record::decode(reader.payload());
            let path = &segment.path;
            let record = record.map_err(|source| Error::Record { path: path.clone(), sequence, source })?;
            self.next += 1;
            self.current = Some((segment, reader));
            return Ok(Some(record));
        }
    }
}

impl Iterator for Replay {
    type Item = Result<Record, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let item = self.advance().transpose();
        self.failed = !matches!(item, Some(Ok(_)));
        item
    }
}
