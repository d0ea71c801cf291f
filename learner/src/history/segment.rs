//! One file of the journal: its header, its frames and what of it still counts.
//!
//! | header | type | | frame | type |
//! |---|---|---|---|---|
//! | magic | 8 bytes | | length of the payload | u32 |
//! | format | u32 | | crc32c of all other bytes of the frame | u32 |
//! | epoch of the learner | u64 | | sequence number | u64 |
//! | sequence number of the first frame | u64 | | records known to be on disk | u64 |
//! | length of the run's name, name | u32, bytes | | payload | bytes |
//! | crc32c of all that | u32 | | | |
//!
//! All numbers are little-endian. A file is named by epoch and first sequence number and appears by rename with its
//! header complete. Nothing is ever cut off or overwritten: in order of (epoch, first) a segment **overrules** what
//! earlier ones hold from its first number on. So a torn tail stays where it is, and what a fenced learner
//! still writes harms nobody.

use super::journal::Error;
use herd_common::caps;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

const MAGIC: [u8; 8] = *b"herd-jnl";
/// Layout of header and frames.
const FORMAT: u32 = 1;
const FIXED_HEADER_BYTES: usize = 8 + 4 + 8 + 8 + 4;
const FRAME_HEADER_BYTES: usize = 4 + 4 + 8 + 8;
/// Longest name of a run; a content hash has 64.
pub(super) const RUN_BYTES: usize = 256;
const EXTENSION: &str = "journal";

/// What names a segment; sorted by precedence, the last one wins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Id {
    /// The learner that wrote it.
    pub(super) epoch: u64,
    /// Its first sequence number.
    pub(super) first: u64,
}

/// A segment on disk.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    /// Its name.
    pub(super) id: Id,
    /// Where it is.
    pub(super) path: PathBuf,
    /// Records from this sequence number on are overruled by later segments.
    pub(super) limit: u64,
}

impl Id {
    pub(super) fn file_name(self) -> String {
        format!("{:08}-{:016}.{EXTENSION}", self.epoch, self.first)
    }

    fn from_file_name(name: &str) -> Option<Self> {
        let (epoch, first) = name.strip_suffix(EXTENSION)?.strip_suffix('.')?.split_once('-')?;
        let id = Self { epoch: epoch.parse().ok()?, first: first.parse().ok()? };
        (id.file_name() == name).then_some(id)
    }
}

/// The segments of a journal in order of precedence.
pub(super) fn list(dir: &Path) -> Result<Vec<Segment>, Error> {
    let io = |source| Error::io("list", dir, source);
    let mut segments = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.extension().is_none_or(|extension| extension != EXTENSION) {
            continue;
        }
        let id = path.file_name().and_then(|name| name.to_str()).and_then(Id::from_file_name);
        let id = id.ok_or_else(|| Error::Damaged { path: path.clone(), offset: 0, what: "the name of the file" })?;
        segments.push(Segment { id, path, limit: u64::MAX });
    }
    segments.sort_by_key(|segment| segment.id);
    let mut limit = u64::MAX;
    for segment in segments.iter_mut().rev() {
        segment.limit = limit;
        limit = limit.min(segment.id.first);
    }
    Ok(segments)
}

/// The bytes of a header.
pub(super) fn header(id: Id, run: &str) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend_from_slice(&FORMAT.to_le_bytes());
    bytes.extend_from_slice(&id.epoch.to_le_bytes());
    bytes.extend_from_slice(&id.first.to_le_bytes());
    bytes.extend_from_slice(&(run.len() as u32).to_le_bytes());
    bytes.extend_from_slice(run.as_bytes());
    bytes.extend_from_slice(&crc32c::crc32c(&bytes).to_le_bytes());
    bytes
}

/// Appends one frame whose payload `write` appends; false, and nothing appended, when it is larger than a record may be.
pub(super) fn frame(bytes: &mut Vec<u8>, sequence: u64, durable: u64, write: impl FnOnce(&mut Vec<u8>)) -> bool {
    let start = bytes.len();
    bytes.extend_from_slice(&[0; FRAME_HEADER_BYTES]);
    write(bytes);
    let length = bytes.len() - start - FRAME_HEADER_BYTES;
    if length > caps::JOURNAL_RECORD_BYTES {
        bytes.truncate(start);
        return false;
    }
    let frame = &mut bytes[start..];
    frame[0..4].copy_from_slice(&(length as u32).to_le_bytes());
    frame[8..16].copy_from_slice(&sequence.to_le_bytes());
    frame[16..24].copy_from_slice(&durable.to_le_bytes());
    let crc = frame_crc(frame);
    frame[4..8].copy_from_slice(&crc.to_le_bytes());
    true
}

fn frame_crc(frame: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(&frame[..4]), &frame[8..])
}

/// The numbers of a frame header: length, crc, sequence, durable.
fn frame_header(bytes: &[u8]) -> Option<(usize, u32, u64, u64)> {
    let (length, rest) = bytes.split_first_chunk()?;
    let (crc, rest) = rest.split_first_chunk()?;
    let (sequence, rest) = rest.split_first_chunk()?;
    let (durable, _) = rest.split_first_chunk()?;
    let (length, crc) = (u32::from_le_bytes(*length), u32::from_le_bytes(*crc));
    Some((length as usize, crc, u64::from_le_bytes(*sequence), u64::from_le_bytes(*durable)))
}

/// What a reader met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// A whole frame; its payload is in the reader.
    Record,
    /// The end of the file, right after a frame.
    End,
    /// Bytes that are not the next frame.
    Bad,
}

/// Reads the frames of one segment in order.
pub(super) struct Reader {
    path: PathBuf,
    input: BufReader<File>,
    bytes: u64,
    offset: u64,
    next: u64,
    frame: Vec<u8>,
}

impl Reader {
    /// Opens a segment and checks that its header belongs to this run (`None`: any) and to its name.
    pub(super) fn open(segment: &Segment, run: Option<&str>) -> Result<Self, Error> {
        let path = segment.path.clone();
        let io = |source| Error::io("open", &path, source);
        let file = File::open(&path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut input = BufReader::with_capacity(1 << 20, file);
        let mut head = Vec::new();
        input.by_ref().take((FIXED_HEADER_BYTES + RUN_BYTES + 4) as u64).read_to_end(&mut head).map_err(io)?;
        let header_bytes = check_header(&head, segment, run)?;
        input.seek(SeekFrom::Start(header_bytes)).map_err(io)?;
        Ok(Self { path, input, bytes, offset: header_bytes, next: segment.id.first, frame: Vec::new() })
    }

    /// The sequence number that the next frame must have.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> u64 {
        self.bytes - self.offset
    }

    /// The payload of the last frame.
    pub(super) fn payload(&self) -> &[u8] {
        &self.frame[FRAME_HEADER_BYTES..]
    }

    /// The error that stands for the bytes at the current offset.
    pub(super) fn damaged(&self, what: &'static str) -> Error {
        Error::Damaged { path: self.path.clone(), offset: self.offset, what }
    }

    /// Reads one frame. After `Bad` the reader is of no further use.
    pub(super) fn step(&mut self) -> Result<Step, Error> {
        if self.left() == 0 {
            return Ok(Step::End);
        }
        if self.left() < FRAME_HEADER_BYTES as u64 {
            return Ok(Step::Bad);
        }
        self.frame.resize(FRAME_HEADER_BYTES, 0);
        self.input.read_exact(&mut self.frame).map_err(|source| Error::io("read", &self.path, source))?;
        let Some((length, crc, sequence, _)) = frame_header(&self.frame) else { return Ok(Step::Bad) };
        let whole = FRAME_HEADER_BYTES + length;
        if length > caps::JOURNAL_RECORD_BYTES || whole as u64 > self.left() || sequence != self.next {
            return Ok(Step::Bad);
        }
        self.frame.resize(whole, 0);
        let payload = &mut self.frame[FRAME_HEADER_BYTES..];
        self.input.read_exact(payload).map_err(|source| Error::io("read", &self.path, source))?;
        if frame_crc(&self.frame) != crc {
            return Ok(Step::Bad);
        }
        self.offset += whole as u64;
        self.next += 1;
        Ok(Step::Record)
    }

    /// After `Bad`: does a later frame prove that the bad one was on disk once? Then this is damage, not a torn
    /// tail: frames written together may reach the disk in any order, those known to be there may not vanish.
    pub(super) fn was_durable(&mut self) -> Result<bool, Error> {
        let io = |source| Error::io("read", &self.path, source);
        let mut rest = Vec::new();
        self.input.seek(SeekFrom::Start(self.offset)).map_err(io)?;
        self.input.by_ref().take(self.bytes - self.offset).read_to_end(&mut rest).map_err(io)?;
        let proves = |tail: &[u8]| {
            let Some((length, crc, sequence, durable)) = frame_header(tail) else { return false };
            let plausible = sequence > self.next && durable > self.next && durable <= sequence;
            plausible && tail.get(..FRAME_HEADER_BYTES + length).is_some_and(|frame| frame_crc(frame) == crc)
        };
        Ok((1..rest.len()).any(|start| proves(&rest[start..])))
    }
}

/// The length of a header that is whole, known and of this segment and run.
fn check_header(head: &[u8], segment: &Segment, run: Option<&str>) -> Result<u64, Error> {
    let path = &segment.path;
    let damaged = || Error::Damaged { path: path.clone(), offset: 0, what: "the header of the file" };
    let word = |at: usize| head.get(at..at + 4)?.first_chunk().copied().map(u32::from_le_bytes);
    let run_bytes = word(FIXED_HEADER_BYTES - 4).ok_or_else(damaged)? as usize;
    let end = FIXED_HEADER_BYTES.saturating_add(run_bytes);
    let covered = head.get(..end).ok_or_else(damaged)?;
    if word(end) != Some(crc32c::crc32c(covered)) || !covered.starts_with(&MAGIC) {
        return Err(damaged());
    }
    let format = word(8).ok_or_else(damaged)?;
    if format != FORMAT {
        return Err(Error::Format { path: path.clone(), found: format, expected: FORMAT });
    }
    let found = std::str::from_utf8(&covered[FIXED_HEADER_BYTES..]).map_err(|_| damaged())?;
    if let Some(expected) = run.filter(|expected| *expected != found) {
        return Err(Error::Foreign { path: path.clone(), found: found.to_owned(), expected: expected.to_owned() });
    }
    if header(segment.id, found)[..] != head[..end + 4] {
        return Err(damaged());
    }
    Ok(end as u64 + 4)
}
