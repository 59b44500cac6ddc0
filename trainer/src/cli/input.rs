//! Measurements that a command reads, which need not be in a file.

use std::path::Path;

/// A measurement file, or its bytes.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The file, or a name for messages.
    pub path: &'a Path,
    /// The bytes of what is in no file.
    pub bytes: Option<&'a [u8]>,
}

impl<'a> Input<'a> {
    /// A file.
    pub fn file(path: &'a Path) -> Self {
        Self { path, bytes: None }
    }
}
