//! The documents of the workspace: their commands work, their links have targets, and their numbers agree.
//!
//! A fenced block is part of the test if one of these comments, which a browser does not show, is before it:
//!
//! ```text
//! <!-- test: file NAME -->       the block is written to NAME
//! <!-- test: run -->             lines that start with "trainer" or "$ trainer" are run, in order
//! <!-- test: run, exit 2 -->     the same with this exit code; other lines must be part of what the program prints
//! <!-- test: first -->           run by a test of its own
//! ```
//!
//! In a block that is run, `cargo run --release -p poegp-tests --example firmware FILE` builds the image without running cargo.
//! All blocks of a document share one new folder. There is no shell, so no quotes, pipes or variables. A line that ends with
//! `&` runs in the background until the end of the document; the next line waits until it has printed its expected output.
//! `until [ -S FILE ]; do sleep 0.1; done` waits for a socket in a shell; here the socket must exist already.
//!
//! `<!-- record: ROW -->NUMBER` quotes the record of docs/evidence/performance.md.

mod agreement;
mod blocks;
mod commands;

use std::fs;
use std::path::{Path, PathBuf};

#[cfg(unix)]
#[allow(dead_code, reason = "the tests of the device use more of it")]
#[path = "../../../tests/src/firmware_build.rs"]
mod firmware_build;

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the package lies in the workspace")
}

fn document(name: &str) -> String {
    fs::read_to_string(workspace().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Returns every Markdown file of the workspace.
fn documents() -> Vec<PathBuf> {
    fn collect(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let skipped = name.starts_with('.') || name == "target" || name == "demo";
            if path.is_dir() && !skipped {
                collect(&path, out);
            } else if name.ends_with(".md") {
                out.push(path);
            }
        }
    }
    let mut all = Vec::new();
    collect(workspace(), &mut all);
    all
}
