//! Where rows come from: standard input, a file that somebody appends to, or a port. A line counts when it has its end.

use std::collections::HashMap;
use std::fmt;
use std::fs::File;
use std::io::{BufRead, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use poegp_calibration::input_error::InputError;

use crate::cli::failure::Failure;
use crate::device::port::{self, Address, AddressError, Stream, advice};

/// How often a file is looked at again, and how long a port is waited for at a time.
const PAUSE: Duration = Duration::from_millis(50);
/// Bytes of a line that is none any more.
const LONGEST: usize = 1 << 16;

/// Where rows come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// `-`.
    Stdin,
    /// A file that grows.
    File(PathBuf),
    /// `serial:DEVICE[@BAUD]`, `unix:PATH` or `tcp:HOST:PORT`.
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

/// Lines as they come.
pub struct Lines {
    name: PathBuf,
    input: Input,
    waiting: Vec<u8>,
    number: usize,
    /// Rows of an earlier session that a file has, too, and how often.
    known: HashMap<String, usize>,
}

impl Lines {
    /// Opens it.
    ///
    /// # Errors
    /// [`InputError`] where it cannot be read.
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

    /// Lines of a file that an earlier session took: they are passed over, each as often as it is here.
    pub fn pass_over(&mut self, known: &[u8]) {
        if let Input::File(_) = self.input {
            for line in String::from_utf8_lossy(known).lines() {
                *self.known.entry(line.trim().to_owned()).or_default() += 1;
            }
        }
    }

    /// What it is called in messages.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// The next line with its number, from 1; `None` when no more come.
    ///
    /// # Errors
    /// [`InputError`] where it cannot be read any further.
    pub fn next(&mut self) -> Result<Option<(usize, String)>, Failure> {
        loop {
            let Some(bytes) = self.whole_line()? else {
                return Ok(None);
            };
            self.number += 1;
            let line = String::from_utf8(bytes).map_err(|_| {
                InputError::new(&self.name, "bytes that are not UTF-8 text", "a row as CSV")
                    .at_line(self.number)
            })?;
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

    /// Reads what there is; `false` when no more comes.
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

    /// Whether the last line never came to its end.
    pub fn is_torn(&self) -> bool {
        !self.waiting.is_empty()
    }
}
