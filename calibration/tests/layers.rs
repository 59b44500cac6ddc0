//! The rooms of the library lie above each other: what a file uses comes from its own room or from one before it.

use std::fs;
use std::path::{Path, PathBuf};

/// From the ground up. A room may use those before it.
const ROOMS: [&str; 14] = [
    "input_error",
    "progress",
    "numeric",
    "device_cost",
    "robot",
    "measurement",
    "identification",
    "learning",
    "model",
    "blob",
    "validation",
    "simulation",
    "planning",
    "verification",
];

fn floor(room: &str) -> usize {
    let found = ROOMS.iter().position(|name| *name == room);
    found.unwrap_or_else(|| panic!("`{room}` has no place among the rooms: {ROOMS:?}"))
}

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// The rooms that a source of `room` uses and that are above it. Its tests may use all, and documentation may point anywhere.
fn upward<'a>(room: &str, source: &'a str) -> Vec<&'a str> {
    let source = source.split("\n#[cfg(test)]\nmod tests {").next().unwrap();
    source
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| line.split("crate::").skip(1))
        .map(|rest| {
            let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            &rest[..end.unwrap_or(rest.len())]
        })
        .filter(|used| {
            used.starts_with(|c: char| c.is_ascii_lowercase()) && floor(used) > floor(room)
        })
        .collect()
}

#[test]
fn no_room_uses_one_above_it() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut arrows = Vec::new();
    for file in &files {
        let inside = file.strip_prefix(&root).unwrap();
        let first = inside.iter().next().unwrap().to_str().unwrap();
        let room = first.trim_end_matches(".rs");
        if room == "lib"
            || inside
                .iter()
                .any(|part| part == "tests" || part == "tests.rs")
        {
            continue;
        }
        for used in upward(room, &fs::read_to_string(file).unwrap()) {
            arrows.push(format!("{}: {used} is above {room}", inside.display()));
        }
    }
    assert!(files.len() > 70, "{}", files.len());
    assert!(arrows.is_empty(), "{arrows:#?}");
}

/// What the law must see, and what it must leave alone.
#[test]
fn an_arrow_that_points_upward_is_seen() {
    let source = "use crate::model::Method;\n//! [`crate::planning`]\nfn f() -> crate::blob::write::Provenance {}\n\
                  #[cfg(test)]\nmod tests {\n    use crate::validation::held_out;\n}";
    assert_eq!(upward("learning", source), ["model", "blob"]);
    assert!(upward("planning", source).is_empty());
}
