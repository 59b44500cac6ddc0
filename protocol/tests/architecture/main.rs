//! The order of the whole workspace, read from its text alone: which file may use which, and which words are not used.
//!
//! It stands in the crate that builds fastest and depends on none of the others.

mod layers;
mod modules;
mod tokens;
mod words;
