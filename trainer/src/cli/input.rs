//! Measurements that a command reads from a file or from memory.

use std::path::Path;

/// A measurement file, or measurements in memory.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// Path of the file, or a name for messages.
    pub path: &'a Path,
    /// Bytes of measurements in memory; `None` if they are in a file.
    pub bytes: Option<&'a [u8]>,
}

impl<'a> Input<'a> {
    /// Creates the input that reads a file.
    pub fn file(path: &'a Path) -> Self {
        Self { path, bytes: None }
    }
}
