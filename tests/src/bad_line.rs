//! A serial line that damages, drops or doubles one byte of a hundred in both directions, at random from a seed.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Counts of the bytes that passed the line and of those that were changed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Harm {
    /// Number of bytes that entered the line, in both directions.
    pub bytes: u64,
    /// Number of bytes that were changed to another value.
    pub damaged: u64,
    /// Number of bytes that were lost.
    pub dropped: u64,
    /// Number of bytes that were sent twice.
    pub doubled: u64,
}

/// A bad line over a stream.
#[derive(Debug)]
pub struct BadLine {
    stream: UnixStream,
    generator: ChaCha8Rng,
    harm: Harm,
}

/// Share of the bytes that are damaged, dropped or doubled.
const SHARE: f64 = 0.01;

impl BadLine {
    /// Creates a bad line over a good stream; a read ends after `patience` at the latest.
    ///
    /// # Errors
    /// The error of the system.
    pub fn over(stream: UnixStream, patience: Duration, seed: u64) -> io::Result<Self> {
        stream.set_read_timeout(Some(patience))?;
        Ok(Self {
            stream,
            generator: ChaCha8Rng::seed_from_u64(seed),
            harm: Harm::default(),
        })
    }

    /// Returns the counts so far.
    pub fn harm(&self) -> Harm {
        self.harm
    }

    fn pass(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len() + 8);
        for byte in bytes {
            self.harm.bytes += 1;
            if !self.generator.random_bool(SHARE) {
                out.push(*byte);
                continue;
            }
            match self.generator.random_range(0..3) {
                0 => {
                    self.harm.damaged += 1;
                    out.push(byte ^ self.generator.random_range(1..=255_u8));
                }
                1 => self.harm.dropped += 1,
                _ => {
                    self.harm.doubled += 1;
                    out.extend([*byte, *byte]);
                }
            }
        }
        out
    }

    /// Sends bytes, some of them damaged, dropped or doubled.
    ///
    /// # Errors
    /// The error of the system.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let bytes = self.pass(bytes);
        self.stream.write_all(&bytes)
    }

    /// Returns the bytes that have arrived; empty if none arrive in time.
    ///
    /// # Errors
    /// The error of the system; `UnexpectedEof` after the other end has closed.
    pub fn receive(&mut self) -> io::Result<Vec<u8>> {
        let mut buffer = [0; 4096];
        match self.stream.read(&mut buffer) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(length) => Ok(self.pass(&buffer[..length])),
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock
                        | io::ErrorKind::TimedOut
                        | io::ErrorKind::Interrupted
                ) =>
            {
                Ok(Vec::new())
            }
            Err(error) => Err(error),
        }
    }
}
