//! Output for people: results, notes, errors with the line they are about, progress, Ctrl-C.

pub mod interrupt;
pub mod print;
pub mod progress;
pub mod snippet;
pub mod table;
pub mod warnings;
