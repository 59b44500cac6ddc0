//! Ports of devices: serial lines, and sockets that stand for one.
//!
//! ```text
//!  /dev/ttyUSB0      a serial line, 115 200 baud by default; eight bits, no parity, one stop bit
//!  /dev/ttyUSB0@BAUD a serial line at another speed
//!  unix:PATH         a socket in the file system (an emulated device, socat)
//!  tcp:HOST:PORT     a TCP socket (a terminal server)
//! ```

use std::fmt;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// Default speed of a serial line, in bits per second, with which the boards of this workspace start.
pub const DEFAULT_BAUD: u32 = 115_200;

/// Address of a port, as a user types it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A serial line.
    Serial {
        /// The device file (`COM3` on Windows).
        path: String,
        /// Bits per second; `None` for [`DEFAULT_BAUD`].
        baud: Option<u32>,
    },
    /// A socket in the file system.
    Unix(PathBuf),
    /// Host and port of a TCP socket.
    Tcp(String),
}

/// Why a text is not an [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found:?} is not a port; expected /dev/ttyUSB0, /dev/ttyUSB0@BAUD, unix:PATH or tcp:HOST:PORT"
)]
pub struct AddressError {
    found: String,
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let bad = || AddressError {
            found: text.to_owned(),
        };
        if let Some(path) = text.strip_prefix("unix:") {
            return (!path.is_empty())
                .then(|| Self::Unix(path.into()))
                .ok_or_else(bad);
        }
        if let Some(location) = text.strip_prefix("tcp:") {
            let (host, port) = location.rsplit_once(':').ok_or_else(bad)?;
            return match port.parse::<u16>() {
                Ok(_) if !host.is_empty() => Ok(Self::Tcp(location.to_owned())),
                _ => Err(bad()),
            };
        }
        let (path, baud) = match text.rsplit_once('@') {
            None => (text, None),
            Some((path, baud)) => (path, Some(baud.parse().map_err(|_| bad())?)),
        };
        if path.is_empty() || baud == Some(0) {
            return Err(bad());
        }
        Ok(Self::Serial {
            path: path.to_owned(),
            baud,
        })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud } => {
                f.write_str(path)?;
                baud.map_or(Ok(()), |baud| write!(f, "@{baud}"))
            }
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(location) => write!(f, "tcp:{location}"),
        }
    }
}

impl Address {
    /// Returns the address with the speed `baud`, where it is a serial line without a speed of its own.
    #[must_use]
    pub fn with_baud(self, baud: Option<u32>) -> Self {
        match self {
            Self::Serial { path, baud: own } => Self::Serial {
                path,
                baud: own.or(baud),
            },
            other => other,
        }
    }
}

/// Bytes to and from a device.
pub trait Stream: Read + Write + Send {
    /// Limits reads from now on: a read that receives nothing for `limit` ends with `WouldBlock` or `TimedOut`.
    ///
    /// # Errors
    /// What the system says.
    fn limit_reads(&mut self, limit: Duration) -> io::Result<()>;
}

#[cfg(unix)]
impl Stream for std::os::unix::net::UnixStream {
    fn limit_reads(&mut self, limit: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(limit))
    }
}

impl Stream for TcpStream {
    fn limit_reads(&mut self, limit: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(limit))
    }
}

/// A serial line.
struct Serial(Box<dyn serialport::SerialPort>);

impl Read for Serial {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Serial {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Stream for Serial {
    fn limit_reads(&mut self, limit: Duration) -> io::Result<()> {
        Ok(self.0.set_timeout(limit)?)
    }
}

/// Longest time that a socket may take to appear.
const CONNECT_LIMIT: Duration = Duration::from_secs(5);

/// Opens a port.
///
/// # Errors
/// What the system says; see [`advice`] for what its user may do.
pub fn open(address: &Address) -> io::Result<Box<dyn Stream>> {
    match address {
        Address::Serial { path, baud } => {
            let line = serialport::new(path.as_str(), baud.unwrap_or(DEFAULT_BAUD))
                .timeout(CONNECT_LIMIT)
                .open()?;
            Ok(Box::new(Serial(line)))
        }
        #[cfg(unix)]
        Address::Unix(path) => Ok(Box::new(std::os::unix::net::UnixStream::connect(path)?)),
        #[cfg(not(unix))]
        Address::Unix(_) => Err(io::ErrorKind::Unsupported.into()),
        Address::Tcp(location) => {
            use std::net::ToSocketAddrs;
            let mut last = io::Error::from(io::ErrorKind::NotFound);
            for location in location.to_socket_addrs()? {
                match TcpStream::connect_timeout(&location, CONNECT_LIMIT) {
                    Ok(stream) => {
                        // A request is one small packet; waiting for more bytes would cost 40 ms for each.
                        stream.set_nodelay(true)?;
                        return Ok(Box::new(stream));
                    }
                    Err(error) => last = error,
                }
            }
            Err(last)
        }
    }
}

/// Returns advice for a port that does not open.
pub fn advice(address: &Address, error: &io::Error) -> &'static str {
    match (address, error.kind()) {
        (Address::Serial { .. }, io::ErrorKind::PermissionDenied) => {
            "your user may not use it: join its group (dialout on Debian), log in again"
        }
        // A locked line is reported like a missing one.
        (Address::Serial { path, .. }, io::ErrorKind::NotFound) if !Path::new(path).exists() => {
            "is it plugged in? `ls /dev/tty*` before and after shows its name"
        }
        (Address::Serial { .. }, _) => "is another program using it?",
        _ => "is something listening there?",
    }
}

/// Returns advice for a device's port that does not open: [`advice`], and where to find an emulated device.
pub fn device_advice(address: &Address, error: &io::Error) -> String {
    let own = match address {
        Address::Serial { .. } => "",
        _ => " `trainer device emulate` starts a device and prints its port",
    };
    format!("{}{own}", advice(address, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_written() {
        for text in [
            "/dev/ttyUSB0",
            "/dev/ttyUSB0@921600",
            "COM3",
            "unix:/tmp/link",
            "tcp:localhost:4000",
            "tcp:[::1]:4000",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "unix:",
            "tcp:",
            "tcp:4000",
            "tcp::4000",
            "tcp:a:x",
            "/dev/a@",
            "/dev/a@0",
            "/dev/a@x",
            "@9600",
        ] {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_speed_in_the_name_wins() {
        let line = |text: &str| text.parse::<Address>().unwrap().with_baud(Some(9_600));
        assert_eq!(line("/dev/a").to_string(), "/dev/a@9600");
        assert_eq!(line("/dev/a@1200").to_string(), "/dev/a@1200");
        assert_eq!(line("unix:/a").to_string(), "unix:/a");
    }
}
