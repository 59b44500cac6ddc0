//! The source of measured rows: standard input, a growing file, or a port. A line counts once its end has arrived.

use std::collections::HashMap;
use std::fmt;
use std::fs::File;
use std::io::{BufRead, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use poegp_calibration::input_error::InputError;

use crate::cli::failure::Failure;
use crate::cli::measure::journal::Journal;
use crate::device::port::{self, Address, AddressError, Stream, advice};

/// Time between two reads of a growing file, and timeout of a read from a port.
const PAUSE: Duration = Duration::from_millis(50);
/// Largest number of bytes in a line; more without the end of a line are an error.
const LONGEST: usize = 1 << 16;

/// The source that the command line names for measured rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Standard input, named `-`.
    Stdin,
    /// A file that another program appends to.
    File(PathBuf),
    /// A port, named `serial:DEVICE[@BAUD]`, `unix:PATH` or `tcp:HOST:PORT`.
    Port(Address),
}

impl FromStr for Origin {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        Ok(match text.strip_prefix("serial:") {
            Some(line) => Self::Port(line.parse()?),
            None if text.starts_with("unix:") || text.starts_with("tcp:") => {
                Self::Port(text.parse()?)
            }
            None if text == "-" => Self::Stdin,
            None => Self::File(text.into()),
        })
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdin => f.write_str("<standard input>"),
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Port(address) => write!(f, "{address}"),
        }
    }
}

enum Input {
    Stdin,
    File(File),
    Port(Box<dyn Stream>),
}

/// A source, open to read lines as they arrive.
pub struct Lines {
    name: PathBuf,
    input: Input,
    waiting: Vec<u8>,
    number: usize,
    /// Lines of an earlier session that the source file repeats, with the number of times that each is to be skipped.
    known: HashMap<String, usize>,
}

impl Lines {
    /// Opens a source.
    ///
    /// # Errors
    /// [`InputError`] if it cannot be read.
    pub fn open(origin: &Origin) -> Result<Self, Failure> {
        let name = PathBuf::from(origin.to_string());
        let input = match origin {
            Origin::Stdin => Input::Stdin,
            Origin::File(path) => Input::File(File::open(path).map_err(|error| {
                InputError::unreadable(path, &error, "a file that rows are appended to")
            })?),
            Origin::Port(address) => {
                let opened = port::open(address).and_then(|mut stream| {
                    stream.limit_reads(PAUSE)?;
                    Ok(stream)
                });
                Input::Port(opened.map_err(|error| {
                    InputError::new(
                        &name,
                        format!("a port that does not open ({error})"),
                        "a port",
                    )
                    .with_help(advice(address, &error))
                })?)
            }
        };
        Ok(Self {
            name,
            input,
            waiting: Vec::new(),
            number: 0,
            known: HashMap::new(),
        })
    }

    /// Skips lines of a source file that an earlier session has taken, each as often as it is in `journal`.
    pub fn pass_over(&mut self, journal: &Journal) {
        if !matches!(self.input, Input::File(_)) {
            return;
        }
        let text = String::from_utf8_lossy(journal.bytes());
        let said = journal.said();
        let answers = said.iter().flat_map(|(said, about)| [said.as_str(), about]);
        for line in text.lines().chain(answers) {
            *self.known.entry(line.trim().to_owned()).or_default() += 1;
        }
    }

    /// Returns the name of the source for messages.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// Waits for the next line; returns its number, from 1, and its text, with U+FFFD in place of what is not UTF-8. `None`
    /// if no more lines come.
    ///
    /// # Errors
    /// [`InputError`] if the source cannot be read any further.
    pub fn next(&mut self) -> Result<Option<(usize, String)>, Failure> {
        loop {
            let Some(bytes) = self.whole_line()? else {
                return Ok(None);
            };
            self.number += 1;
            // A byte that is not UTF-8 may be in a comment; it makes a row one that cannot be used.
            let line = String::from_utf8_lossy(&bytes);
            let line = line.trim().trim_start_matches('\u{feff}').to_owned();
            match self.known.get_mut(&line) {
                Some(count) if *count > 0 => *count -= 1,
                _ => return Ok(Some((self.number, line))),
            }
        }
    }

    fn whole_line(&mut self) -> Result<Option<Vec<u8>>, Failure> {
        loop {
            if let Some(end) = self.waiting.iter().position(|byte| *byte == b'\n') {
                let rest = self.waiting.split_off(end + 1);
                let mut line = std::mem::replace(&mut self.waiting, rest);
                line.pop();
                return Ok(Some(line));
            }
            if self.waiting.len() > LONGEST {
                let found = format!("more than {LONGEST} bytes without the end of a line");
                return Err(InputError::new(&self.name, found, "a row as CSV")
                    .at_line(self.number + 1)
                    .into());
            }
            match self.more() {
                Ok(true) => {}
                Ok(false) => return Ok(None),
                Err(error) => {
                    let found = format!("something that cannot be read any further ({error})");
                    return Err(InputError::new(&self.name, found, "rows as CSV").into());
                }
            }
        }
    }

    /// Reads the bytes that have arrived; returns `false` if no more will come.
    fn more(&mut self) -> std::io::Result<bool> {
        use std::io::{Error, ErrorKind};
        match &mut self.input {
            Input::Stdin => {
                let read = std::io::stdin()
                    .lock()
                    .read_until(b'\n', &mut self.waiting)?;
                Ok(read > 0)
            }
            Input::File(file) => {
                if file.read_to_end(&mut self.waiting)? == 0 {
                    let at = file.stream_position()?;
                    if file.metadata()?.len() < at {
                        file.seek(SeekFrom::Start(at))?;
                        return Err(Error::new(ErrorKind::InvalidData, "it became shorter"));
                    }
                    std::thread::sleep(PAUSE);
                }
                Ok(true)
            }
            Input::Port(stream) => {
                let mut buffer = [0; 1024];
                match stream.read(&mut buffer) {
                    Ok(0) => Ok(false),
                    Ok(count) => {
                        self.waiting.extend_from_slice(&buffer[..count]);
                        Ok(true)
                    }
                    Err(error)
                        if matches!(
                            error.kind(),
                            ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                        ) =>
                    {
                        Ok(true)
                    }
                    Err(error) => Err(error),
                }
            }
        }
    }

    /// Whether the last line is incomplete.
    pub fn is_torn(&self) -> bool {
        !self.waiting.is_empty()
    }
}
