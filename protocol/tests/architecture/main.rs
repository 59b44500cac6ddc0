//! The structure of the whole workspace, read from its sources: which file may use which, and which words are forbidden.
//!
//! The tests are in this crate because it builds fastest and depends on none of the others.

mod layers;
mod modules;
mod tokens;
mod words;
