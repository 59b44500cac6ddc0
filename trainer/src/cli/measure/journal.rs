//! The file of measured rows: a row is on disk before anybody is informed that it is accepted.
//!
//! A row counts when its line is complete. A power failure may leave part of a line: the next start turns that part into a
//! comment and reports it. All lines before it are complete.
//!
//! A program that saves a file by renaming another one to its name, or that removes it, leaves an open file behind that no
//! path leads to. Every row is therefore written to the file that stands at the path then, and read from the path before
//! it counts.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::is_remark;

use crate::cli::failure::Failure;
use crate::cli::output::transaction::{Readers, Staged, commit, folder_of, sync, writing};
use crate::cli::terminal::print::warning;

/// Times that a line is written when another file appears at the path each time.
const ATTEMPTS: usize = 5;

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
    /// [`InputError`] if another program is writing the file or it is none, [`Failure::LostOutput`] if it cannot be written.
    pub fn open(path: &Path) -> Result<(Self, Option<String>), Failure> {
        let _writing = writing();
        let lost = |error| Failure::lost(path, error);
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let file = options.open(path).map_err(lost)?;
        if !file.metadata().map_err(lost)?.is_file() {
            let expected = "a file that rows can be added to";
            return Err(InputError::new(path, "a device or a pipe", expected).into());
        }
        let mut out = Self {
            path: path.to_path_buf(),
            file,
            bytes: Vec::new(),
        };
        if !out.lock() {
            let found = "a file that another measurement is writing to";
            return Err(InputError::new(path, found, "a file for each measurement").into());
        }
        sync(folder_of(path)).map_err(lost)?;
        out.bytes = out.contents().map_err(lost)?;
        let torn = out.mend().map_err(lost)?;
        Ok((out, torn))
    }

    /// Keeps other measurements out of the open file; returns `false` if one is writing to it.
    fn lock(&self) -> bool {
        // Some file systems have no locks.
        !matches!(self.file.try_lock(), Err(TryLockError::WouldBlock))
    }

    /// Returns the contents of the open file.
    fn contents(&mut self) -> std::io::Result<Vec<u8>> {
        let mut out = Vec::new();
        self.file.seek(SeekFrom::Start(0))?;
        self.file.read_to_end(&mut out)?;
        Ok(out)
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

    /// Appends a line. It is on disk, in the file that stands at the path, when this returns; after an error the rows that
    /// were there before are.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn append(&mut self, line: &str) -> Result<OnDisk, Failure> {
        let mut after = self.bytes.clone();
        after.extend(format!("{line}\n").into_bytes());
        self.change(after)
    }

    /// Writes `after` in place of what this journal has written so far; both differ behind their common beginning.
    fn change(&mut self, after: Vec<u8>) -> Result<OnDisk, Failure> {
        let _writing = writing();
        for _ in 0..ATTEMPTS {
            self.follow(&after)?;
            let common = self.bytes.iter().zip(&after).take_while(|(a, b)| a == b);
            let from = common.count();
            let written = self
                .file
                .seek(SeekFrom::Start(from as u64))
                .and_then(|_| self.file.write_all(&after[from..]))
                .and_then(|()| self.file.sync_data());
            if let Err(error) = written {
                let _ = self.file.set_len(self.bytes.len() as u64);
                return Err(Failure::lost(&self.path, error));
            }
            if self.stands().is_ok_and(|found| found == after) {
                self.bytes = after;
                return Ok(OnDisk(()));
            }
        }
        Err(self.rescued(&after))
    }

    /// Checks that the confirmed rows are in the file that stands at the path.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn check(&mut self) -> Result<(), Failure> {
        let _writing = writing();
        let bytes = self.bytes.clone();
        self.follow(&bytes)
    }

    /// Opens the file that now stands at the path, in place of the one that was open, and returns its contents.
    fn stands(&mut self) -> std::io::Result<Vec<u8>> {
        let file = OpenOptions::new().read(true).write(true).open(&self.path)?;
        // Two handles of one file exclude each other, too.
        let _ = self.file.unlock();
        self.file = file;
        if !self.lock() {
            return Err(std::io::Error::other(
                "another measurement is writing to it",
            ));
        }
        self.contents()
    }

    /// Makes the file at the path that of this journal: one without the last rows gets them again, and one that is gone is
    /// written again. A file with other rows is left as it is, and `after` is saved beside it.
    fn follow(&mut self, after: &[u8]) -> Result<(), Failure> {
        let path = self.path.clone();
        let lost = |error| Failure::lost(&path, error);
        match self.stands() {
            Ok(found) if found == self.bytes => return sync(folder_of(&path)).map_err(lost),
            Ok(found) if self.bytes.starts_with(&found) => {
                let missing = &self.bytes[found.len()..];
                let written = self.file.seek(SeekFrom::End(0));
                let written = written.and_then(|_| self.file.write_all(missing));
                written
                    .and_then(|()| self.file.sync_all())
                    .and_then(|()| sync(folder_of(&path)))
                    .map_err(lost)?;
            }
            Ok(_) => return Err(self.rescued(after)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                commit(vec![Staged::new_file(&path, &self.bytes, Readers::All)?])?;
            }
            Err(error) => return Err(lost(error)),
        }
        warning(format_args!(
            "{}: confirmed rows were gone from the file; they are written there again",
            path.display()
        ));
        match self.stands() {
            Ok(found) if found == self.bytes => Ok(()),
            _ => Err(self.rescued(after)),
        }
    }

    /// Saves `rows` to a new file beside the one at the path, and returns the error that says so.
    fn rescued(&self, rows: &[u8]) -> Failure {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let beside = (1..100).find_map(|number| {
            let path = self
                .path
                .with_file_name(format!("{stem}-rescued-{number}.csv"));
            let file = Staged::new_file(&path, rows, Readers::All).ok()?;
            commit(vec![file]).ok().map(|()| path)
        });
        let found = "found other rows than those that were confirmed (another program has saved the file), expected the \
                     file as this measurement has left it";
        let name = self.path.display();
        let help = match beside {
            Some(path) => format!(
                "the confirmed rows and the last one are in {}; merge them into {name}, and start the same command \
                 again",
                path.display()
            ),
            None => format!(
                "save these rows, and start the same command again:\n{}",
                String::from_utf8_lossy(rows)
            ),
        };
        let error = std::io::Error::other(format!("{found}\nhelp: {help}"));
        Failure::lost(&self.path, error)
    }
}

impl Journal {
    /// Takes back the row in this line of the file, counted from 1: `said` says so in a comment at the end, and the row
    /// becomes a comment. Returns the row.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn take_back(&mut self, line: usize, said: &str) -> Result<String, Failure> {
        let text = String::from_utf8_lossy(&self.bytes).into_owned();
        let mut lines = text.split_inclusive('\n');
        let at: usize = lines.by_ref().take(line - 1).map(str::len).sum();
        let line = lines.next().unwrap_or_default();
        let row = line.trim().to_owned();
        let OnDisk(()) = self.append(&format!("# {said}: {row}"))?;
        let mut after = self.bytes.clone();
        after[at..at + line.len()].copy_from_slice(commented(line).as_bytes());
        let OnDisk(()) = self.change(after)?;
        Ok(row)
    }

    /// Returns what was said of rows: pairs of the answer and what it was about, such as (`skip`, `line 12 at 1,2,3`) and
    /// (`undo`, the row).
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

/// An answer that is no row, in upper or lower case.
#[derive(Debug, PartialEq, Eq)]
pub enum Word {
    /// Ends the measurement, which can be continued later.
    End,
    /// Asks which answers there are.
    Help,
    /// Leaves out the row of the plan that is asked for.
    Skip,
    /// Takes back a row, or the last one, as the answer says. What is no number takes back row 0, which there is none of.
    Undo(Option<usize>, String),
    /// Letters that are none of these.
    Unknown,
}

impl Word {
    /// What an unknown word is refused for, for messages.
    pub const EXPECTED: &str = "a row, or one of skip, undo, undo 5, end and help";

    /// Returns the word of a line; `None` if it may be a row.
    pub fn of(line: &str) -> Option<Self> {
        let word = line.trim().to_lowercase();
        match word.as_str() {
            "end" | "quit" | "exit" => return Some(Self::End),
            "help" | "?" => return Some(Self::Help),
            SKIP => return Some(Self::Skip),
            _ => {}
        }
        if let Some(row) = word.strip_prefix(UNDO) {
            let row = row.trim();
            let row = (!row.is_empty()).then(|| row.parse().unwrap_or(0));
            return Some(Self::Undo(row, word));
        }
        word.chars()
            .all(char::is_alphabetic)
            .then_some(Self::Unknown)
    }
}

/// Returns a row as a comment of as many bytes: `#` stands for its first character, and for the first two where it would
/// otherwise begin an error of a spreadsheet.
fn commented(row: &str) -> String {
    let without = |count: usize| {
        let bytes: usize = row.chars().take(count).map(char::len_utf8).sum();
        let blanks = " ".repeat(bytes.saturating_sub(1));
        format!("#{blanks}{}", &row[bytes..])
    };
    let out = without(1);
    match is_remark(out.trim()) {
        true => out,
        false => without(2),
    }
}

/// Returns the first line of a table that is neither blank nor a comment.
pub fn first_line(text: &str) -> Option<&str> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().map(str::trim);
    lines.find(|line| !is_remark(line))
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

    /// Whatever a row begins with, it is a comment of every reader once it is taken back, and the file is text.
    #[test]
    fn a_row_that_is_taken_back_is_a_comment_whatever_it_begins_with() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let (mut journal, _) = Journal::open(&path).unwrap();
        let rows = ["Öse,1", "€,2", "ANV,3", "SA/B,4", "1###,5", "B!,6", "7,8"];
        for line in ["feature,q1_deg"].into_iter().chain(rows) {
            let OnDisk(()) = journal.append(line).unwrap();
        }
        let length = journal.bytes().len();
        for (line, row) in (2..).zip(rows) {
            assert_eq!(journal.take_back(line, "undo").unwrap(), row);
        }
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text[..length].matches('\n').count(), rows.len() + 1);
        for line in text.lines().skip(1) {
            assert_eq!(first_line(line), None, "{line}");
        }
    }

    /// Other programs save the file by renaming a copy to its name, remove it, or empty it: all rows are in the file at the
    /// path when they are confirmed. Rows of others are never overwritten.
    #[test]
    fn a_confirmed_row_is_at_the_path_whatever_stands_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let (mut journal, _) = Journal::open(&path).unwrap();
        let mut all = String::new();
        let mut old = String::new();
        for (number, what) in (1..).zip(["nothing", "copied", "old", "gone", "emptied", "undone"]) {
            match what {
                "copied" | "old" => {
                    let other = folder.path().join("saved.tmp");
                    std::fs::write(&other, if what == "old" { &old } else { &all }).unwrap();
                    std::fs::rename(&other, &path).unwrap();
                }
                "gone" => std::fs::remove_file(&path).unwrap(),
                "emptied" => std::fs::write(&path, "").unwrap(),
                _ => {}
            }
            old.clone_from(&all);
            all += &format!("{number},{what}\n");
            let OnDisk(()) = journal.append(&format!("{number},{what}")).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), all, "{what}");
            assert!(
                Journal::open(&path).is_err(),
                "one program at a time: {what}"
            );
        }
        std::fs::remove_file(&path).unwrap();
        assert_eq!(journal.take_back(6, "undo").unwrap(), "6,undone");
        all = all.replace("6,undone", "#,undone") + "# undo: 6,undone\n";
        std::fs::remove_file(&path).unwrap();
        journal.check().unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), all);
        let others = all.replace("2,copied", "2,corrected");
        std::fs::write(&path, &others).unwrap();
        for number in 1..3 {
            let error = journal.append("7,lost").unwrap_err().to_string();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), others);
            let rescued = folder.path().join(format!("rows-rescued-{number}.csv"));
            assert!(error.contains(&rescued.display().to_string()), "{error}");
            let rescued = std::fs::read_to_string(rescued).unwrap();
            assert_eq!(rescued, format!("{all}7,lost\n"));
        }
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
