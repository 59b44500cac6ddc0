//! The file of measured rows: a row is on disk before anybody is informed that it is accepted.
//!
//! A row counts when its line is complete. A power failure may leave part of a line: the next start turns that part into a
//! comment and reports it. All lines before it are complete.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;

use crate::cli::failure::Failure;
use crate::cli::output::transaction::writing;

/// Proof that a row is on disk: only writing the row creates one, and no row is confirmed without it.
#[derive(Debug)]
#[must_use]
pub struct OnDisk(());

/// The measurement file, open to append one row at a time.
pub struct Journal {
    path: PathBuf,
    file: File,
    bytes: Vec<u8>,
}

impl Journal {
    /// Opens or creates the file. Also returns the incomplete last line, if a power failure has left one.
    ///
    /// # Errors
    /// [`InputError`] if another program is writing the file, [`Failure::LostOutput`] if it cannot be written.
    pub fn open(path: &Path) -> Result<(Self, Option<String>), Failure> {
        let _writing = writing();
        let lost = |error| Failure::lost(path, error);
        let is_new = !path.exists();
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let file = options.open(path).map_err(lost)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let found = "a file that another measurement is writing to";
                return Err(InputError::new(path, found, "a file for each measurement").into());
            }
            // Some file systems have no locks.
            Err(TryLockError::Error(_)) => {}
        }
        if is_new {
            on_disk(path).map_err(lost)?;
        }
        let bytes = std::fs::read(path).map_err(lost)?;
        let mut out = Self {
            path: path.to_path_buf(),
            file,
            bytes,
        };
        let torn = out.mend().map_err(lost)?;
        Ok((out, torn))
    }

    /// Turns the incomplete text behind the last complete line into a comment, and returns that text.
    fn mend(&mut self) -> std::io::Result<Option<String>> {
        let complete = match self.bytes.iter().rposition(|byte| *byte == b'\n') {
            Some(last) => last + 1,
            None => 0,
        };
        if complete == self.bytes.len() {
            return Ok(None);
        }
        let torn = String::from_utf8_lossy(&self.bytes[complete..]).into_owned();
        // After a power failure, a file system may leave zeros in place of data.
        let torn: String = torn.chars().filter(|c| !c.is_control()).collect();
        let mut tail = Vec::new();
        if !torn.is_empty() {
            tail = format!("# torn, left out: {torn}\n").into_bytes();
        }
        self.bytes.truncate(complete);
        self.file.set_len(complete as u64)?;
        self.file.seek(SeekFrom::End(0))?;
        self.file.write_all(&tail)?;
        self.file.sync_all()?;
        self.bytes.extend(tail);
        Ok((!torn.is_empty()).then_some(torn))
    }

    /// Returns the whole contents of the file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the first line that is neither blank nor a comment.
    pub fn header(&self) -> Option<String> {
        let text = String::from_utf8_lossy(&self.bytes);
        first_line(&text).map(str::to_owned)
    }

    /// Appends a line. It is on disk when this returns; after an error the file is unchanged.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn append(&mut self, line: &str) -> Result<OnDisk, Failure> {
        let _writing = writing();
        let line = format!("{line}\n");
        let written = self
            .file
            .seek(SeekFrom::End(0))
            .and_then(|_| self.file.write_all(line.as_bytes()))
            .and_then(|()| self.file.sync_data());
        if let Err(error) = written {
            let _ = self.file.set_len(self.bytes.len() as u64);
            return Err(Failure::lost(&self.path, error));
        }
        self.bytes.extend(line.into_bytes());
        Ok(OnDisk(()))
    }
}

impl Journal {
    /// Takes back the row in this line of the file, counted from 1: `said` says so in a comment at the end, and the first
    /// character of the row becomes that of a comment. Returns the row.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn take_back(&mut self, line: usize, said: &str) -> Result<String, Failure> {
        let text = String::from_utf8_lossy(&self.bytes).into_owned();
        let mut lines = text.split_inclusive('\n');
        let at: usize = lines.by_ref().take(line - 1).map(str::len).sum();
        let row = lines.next().unwrap_or_default().trim().to_owned();
        let OnDisk(()) = self.append(&format!("# {said}: {row}"))?;
        let _writing = writing();
        self.file
            .seek(SeekFrom::Start(at as u64))
            .and_then(|_| self.file.write_all(b"#"))
            .and_then(|()| self.file.sync_data())
            .map_err(|error| Failure::lost(&self.path, error))?;
        self.bytes[at] = b'#';
        Ok(row)
    }

    /// Returns what was said of rows: pairs of the answer and what it was about, such as (`skip`, `line 12`) and (`undo`,
    /// the row).
    pub fn said(&self) -> Vec<(String, String)> {
        let text = String::from_utf8_lossy(&self.bytes);
        let of = |line: &str| {
            let (said, about) = line.strip_prefix("# ")?.split_once(": ")?;
            let word = said.split(' ').next()?;
            [SKIP, UNDO]
                .contains(&word)
                .then(|| (said.to_owned(), about.to_owned()))
        };
        text.lines().filter_map(of).collect()
    }
}

/// The answer that leaves out the row of the plan that is asked for.
pub const SKIP: &str = "skip";
/// The answer that takes back the last row, or with a number that row.
pub const UNDO: &str = "undo";

/// Returns the first line of a table that is neither blank nor a comment.
pub fn first_line(text: &str) -> Option<&str> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().map(str::trim);
    lines.find(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Writes the name of a new file to disk, too, by synchronizing its folder.
fn on_disk(path: &Path) -> std::io::Result<()> {
    if !cfg!(unix) {
        return Ok(());
    }
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => File::open(folder)?.sync_all(),
        _ => File::open(".")?.sync_all(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_is_taken_back_is_a_comment() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let (mut journal, _) = Journal::open(&path).unwrap();
        for line in ["# skip: line 7", "q1_deg,x_mm", "1,2", "3,4"] {
            let OnDisk(()) = journal.append(line).unwrap();
        }
        assert_eq!(journal.take_back(3, "undo 1").unwrap(), "1,2");
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(
            text,
            "# skip: line 7\nq1_deg,x_mm\n#,2\n3,4\n# undo 1: 1,2\n"
        );
        assert_eq!(journal.bytes(), text.as_bytes());
        let said = journal.said();
        let said: Vec<_> = said.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
        assert_eq!(said, [("skip", "line 7"), ("undo 1", "1,2")]);
    }

    #[test]
    fn what_is_complete_stays_and_what_is_torn_becomes_a_comment() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let (mut journal, torn) = Journal::open(&path).unwrap();
        assert_eq!((journal.header(), torn), (None, None));
        let OnDisk(()) = journal.append("q1_deg,x_mm").unwrap();
        let OnDisk(()) = journal.append("1,2").unwrap();
        assert!(Journal::open(&path).is_err(), "one program at a time");
        drop(journal);
        for (tail, kept) in [("3,", "# torn, left out: 3,\n"), ("\0\0\0", "")] {
            let before = std::fs::read_to_string(&path).unwrap();
            std::fs::write(&path, format!("{before}{tail}")).unwrap();
            let (journal, torn) = Journal::open(&path).unwrap();
            assert_eq!(torn.is_some(), !kept.is_empty());
            assert_eq!(journal.header().as_deref(), Some("q1_deg,x_mm"));
            let after = std::fs::read_to_string(&path).unwrap();
            assert_eq!(after, format!("{before}{kept}"));
            assert_eq!(journal.bytes(), after.as_bytes());
        }
    }
}
