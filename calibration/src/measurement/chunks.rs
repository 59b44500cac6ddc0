//! Reads a CSV file of any length in chunks of whole records.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::input_error::InputError;
use crate::measurement::table::{
    MEASURED_POSE, Part, Quoting, Table, check_header, each_line, is_remark, no_header, text,
};

/// Number of lines in a chunk; a chunk is longer if its last record continues on further lines.
pub const CHUNK_LINES: usize = 1024;

/// A chunk of a file: consecutive lines that form whole records.
pub struct Chunk {
    /// Number of the chunk's first line in the file, from 1.
    first: usize,
    bytes: Vec<u8>,
}

impl Chunk {
    /// Returns the length of the chunk's lines in bytes.
    pub fn size(&self) -> usize {
        self.bytes.len()
    }

    /// Passes each part of the chunk to `show`, in order; `file` is for messages.
    pub(super) fn each_line(
        &self,
        file: &Path,
        show: impl FnMut(Part<'_>) -> Result<(), InputError>,
    ) -> Result<(), InputError> {
        let text = text(file, &self.bytes, self.first)?;
        each_line(file, text, self.first, show)
    }
}

/// Reader of a file's header and then of its chunks.
pub(super) struct Chunks<R> {
    path: PathBuf,
    /// What the file should be, for messages.
    what: &'static str,
    lines: R,
    /// Number of lines read so far.
    count: usize,
}

impl Chunks<BufReader<File>> {
    /// Opens a file; `what` is the kind of file expected, for messages.
    pub(super) fn open(path: &Path, what: &'static str) -> Result<Self, InputError> {
        let file = File::open(path).map_err(|error| InputError::unreadable(path, &error, what))?;
        Ok(Self::new(
            path,
            what,
            BufReader::with_capacity(1 << 16, file),
        ))
    }
}

impl<R: BufRead> Chunks<R> {
    /// Creates a reader of `lines`; `path` and `what` are for messages.
    pub(super) fn new(path: &Path, what: &'static str, lines: R) -> Self {
        Self {
            path: path.to_path_buf(),
            what,
            lines,
            count: 0,
        }
    }

    /// Reads the beginning of the file up to and including its header. Returns it with a table that has the header but no
    /// rows.
    pub(super) fn header(&mut self) -> Result<(Chunk, Table), InputError> {
        let mut bytes = Vec::new();
        let is_header = |line: &[u8]| {
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
            !is_remark(String::from_utf8_lossy(line).trim())
        };
        while self
            .line(&mut bytes)?
            .is_some_and(|start| !is_header(&bytes[start..]))
        {}
        let start = Chunk { first: 1, bytes };
        let start = self.completed(start)?;
        let mut header: Option<(usize, StringRecord)> = None;
        start.each_line(&self.path, |part| {
            match (part, &header) {
                (Part::Record(line, record), None) => header = Some((line, record.clone())),
                (Part::Record(line, _), Some(_)) => {
                    return Err(InputError::new(
                        &self.path,
                        "a carriage return within a line",
                        "lines that end with a line feed",
                    )
                    .at_line(line));
                }
                _ => {}
            }
            Ok(())
        })?;
        let (header_line, header) = header.ok_or_else(|| no_header(&self.path, MEASURED_POSE))?;
        check_header(&self.path, header_line, &header)?;
        let table = Table {
            header_line,
            header,
            rows: Vec::new(),
        };
        Ok((start, table))
    }

    /// Reads the next chunk; `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<Chunk>, InputError> {
        let mut chunk = Chunk {
            first: self.count + 1,
            bytes: Vec::new(),
        };
        for _ in 0..CHUNK_LINES {
            if self.line(&mut chunk.bytes)?.is_none() {
                break;
            }
        }
        if chunk.bytes.is_empty() {
            return Ok(None);
        }
        self.completed(chunk).map(Some)
    }

    /// Completes a chunk with the further lines of its last record.
    fn completed(&mut self, mut chunk: Chunk) -> Result<Chunk, InputError> {
        if !chunk.bytes.contains(&b'"') {
            return Ok(chunk);
        }
        let mut state = Quoting::default();
        let mut pass = |bytes: &[u8]| {
            for line in bytes.split(|byte| *byte == b'\n') {
                let line = String::from_utf8_lossy(line);
                let line = line.trim_start_matches('\u{feff}').trim();
                if !state.is_remark(line) {
                    state = state.after(line.as_bytes());
                }
            }
            state == Quoting::Open
        };
        let mut is_open = pass(&chunk.bytes);
        while is_open && let Some(start) = self.line(&mut chunk.bytes)? {
            is_open = pass(&chunk.bytes[start..]);
        }
        Ok(chunk)
    }

    /// Appends the next line to `bytes` and returns where in `bytes` it starts; `None` at the end of the file.
    fn line(&mut self, bytes: &mut Vec<u8>) -> Result<Option<usize>, InputError> {
        let start = bytes.len();
        let read = self.lines.read_until(b'\n', bytes);
        read.map_err(|error| InputError::unreadable(&self.path, &error, self.what))?;
        let is_there = bytes.len() > start;
        self.count += usize::from(is_there);
        Ok(is_there.then_some(start))
    }
}
