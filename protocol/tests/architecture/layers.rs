//! A file uses only files of its own layer (here: room) or of a lower one, in its own crate or in a lower one, without
//! cycles.
//!
//! File A uses file B if a path in A, after its imports and re-exports are followed, ends at something that B defines. A
//! re-export is not a use, so that a `mod.rs` may re-export what its files define. Methods are not followed, because their
//! types are. Code for tests only may use anything.

use super::modules::Crate;
use super::tokens::workspace;

struct Layer {
    name: &'static str,
    folder: &'static str,
    /// The crates that it may use.
    below: &'static [&'static str],
    /// The rooms from the lowest up; each may use those before it. A crate without a list is one room.
    rooms: &'static [&'static str],
}

const CRATES: [Layer; 7] = [
    Layer {
        name: "poegp_protocol",
        folder: "protocol/src",
        below: &[],
        rooms: &["limits", "cause", "blob", "link"],
    },
    Layer {
        name: "poegp_runtime",
        folder: "runtime/src",
        below: &["poegp_protocol"],
        rooms: &[
            "assembly",
            "math",
            "kinematics",
            "trace",
            "guard",
            "gp",
            "elastic",
            "model",
            "filter",
            "correct",
            "store",
            "service",
        ],
    },
    Layer {
        name: "poegp_capi",
        folder: "runtime/capi/src",
        below: &["poegp_protocol", "poegp_runtime"],
        rooms: &[],
    },
    Layer {
        name: "poegp_calibration",
        folder: "calibration/src",
        below: &["poegp_protocol", "poegp_runtime"],
        rooms: &[
            "input_error",
            "progress",
            "memory",
            "numeric",
            "device_cost",
            "robot",
            "measurement",
            "identification",
            "trust",
            "learning",
            "model",
            "blob",
            "validation",
            "simulation",
            "planning",
            "verification",
            "error",
        ],
    },
    Layer {
        name: "poegp_trainer",
        folder: "trainer/src",
        below: &["poegp_protocol", "poegp_runtime", "poegp_calibration"],
        rooms: &[
            "import",
            "export",
            "robot_programs",
            "report",
            "device",
            "bridge",
            "signing",
            "cli",
        ],
    },
    Layer {
        name: "poegp",
        folder: "python/src",
        below: &[
            "poegp_protocol",
            "poegp_runtime",
            "poegp_calibration",
            "poegp_trainer",
        ],
        rooms: &["errors", "arrays", "table", "options", "commands", "model"],
    },
    Layer {
        name: "poegp_firmware",
        folder: "firmware/src",
        below: &["poegp_protocol", "poegp_runtime"],
        rooms: &[],
    },
];

/// Folders and files with cycles that still have to be removed. This list may only become shorter.
const CIRCLES_LEFT: [&str; 0] = [];

/// Returns the room of a file. The root of a crate has none: everything may use what it defines, and it may use all rooms.
fn room(file: &str) -> Option<&str> {
    let first = file.split('/').next().unwrap().trim_end_matches(".rs");
    (first != "lib" && first != "main").then_some(first)
}

/// Returns the uses that point to a higher room, as texts.
fn upward(rooms: &[&str], read: &Crate) -> Vec<String> {
    let floor = |room: &str| {
        let found = rooms.iter().position(|name| *name == room);
        found.unwrap_or_else(|| panic!("`{room}` is not in the list of rooms {rooms:?}"))
    };
    let is_upward = |from: &str, to: &str| match (room(from), room(to)) {
        (Some(from), Some(to)) => !rooms.is_empty() && floor(to) > floor(from),
        _ => false,
    };
    let arrows = read
        .arrows
        .iter()
        .filter(|arrow| is_upward(&arrow.from, &arrow.to));
    arrows.map(ToString::to_string).collect()
}

/// Returns the uses in every cycle, except those of the folders `left`.
fn circles(read: &Crate, folder: &str, left: &[&str]) -> Vec<String> {
    let is_left = |file: &String| {
        left.iter()
            .any(|l| format!("{folder}/{file}").starts_with(l))
    };
    let mut out = Vec::new();
    for circle in read.circles() {
        if !circle.iter().all(is_left) {
            let inside = |file| circle.contains(file);
            let arrows = read
                .arrows
                .iter()
                .filter(|a| inside(&a.from) && inside(&a.to));
            out.extend(arrows.map(ToString::to_string));
        }
    }
    out
}

fn every(check: impl Fn(&Layer, &Crate) -> Vec<String>) {
    for layer in &CRATES {
        let read = Crate::read(layer.name, &workspace(layer.folder));
        assert!(read.files.len() > 6, "{}: {:?}", layer.name, read.files);
        assert!(read.lost.is_empty(), "{}: {:#?}", layer.name, read.lost);
        let wrong = check(layer, &read);
        assert!(wrong.is_empty(), "{}: {wrong:#?}", layer.name);
    }
}

#[test]
fn no_crate_uses_one_that_is_not_below() {
    every(|layer, read| {
        let other = read
            .crates
            .iter()
            .filter(|(name, _)| !layer.below.contains(&name.as_str()));
        other
            .map(|(name, file)| format!("{file}: {name}"))
            .collect()
    });
}

#[test]
fn no_room_uses_one_above_it() {
    every(|layer, read| upward(layer.rooms, read));
}

#[test]
fn no_file_uses_itself_through_others() {
    every(|layer, read| circles(read, layer.folder, &CIRCLES_LEFT));
}

/// Violations that the laws must find, and uses that they must accept: a lower room, a folder that re-exports its files,
/// tests, documentation.
#[test]
fn planted_arrows_are_seen() {
    let texts = [
        (
            "lib.rs",
            "pub mod low; pub mod high; pub const N: usize = 3; use poegp_trainer::cli;",
        ),
        (
            "low/mod.rs",
            "mod a; mod b; pub use a::{one, Two as Deux}; pub use b::*; #[cfg(test)] mod tests;",
        ),
        (
            "low/a.rs",
            "pub fn one() -> crate::high::Top { super::b::three() } pub struct Two; // crate::high::Top\n",
        ),
        (
            "low/b.rs",
            "//! [`crate::high`]\nuse super::Deux;\npub fn three() { crate::N; \"crate::high::Top\"; }",
        ),
        ("low/tests.rs", "use crate::high::Top;"),
        (
            "high.rs",
            "use crate::low;\npub struct Top;\nfn f() { low::one(); }\n#[cfg(test)]\nmod tests { use super::*; }",
        ),
    ];
    let read = Crate::of("planted", &texts);
    assert_eq!(read.lost, Vec::<String>::new());
    assert_eq!(
        upward(&["low", "high"], &read),
        ["low/a.rs:1 uses high.rs: crate::high::Top"]
    );
    assert_eq!(read.circles(), [["high.rs", "low/a.rs", "low/b.rs"]]);
    assert_eq!(
        circles(&read, "src", &["src/high.rs", "src/low/"]),
        Vec::<String>::new()
    );
    assert_eq!(circles(&read, "src", &["src/low/"]).len(), 4);
    assert_eq!(read.crates.len(), 1);
    let lost = Crate::of("planted", &[("lib.rs", "fn f() { crate::nothing::g() }")]).lost;
    assert_eq!(lost, ["lib.rs:1: crate::nothing::g"]);
}
