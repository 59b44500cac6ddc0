//! Arbitrary bytes against everything that reads: for each a function that panics when a law is broken.
//!
//! | target | law beyond "no panic" |
//! |---|---|
//! | [`blob`](wire::blob) | refused: the model that was there stays. Taken: every answer is finite, no joint is corrected by more than the bound; what is written of it reads the same |
//! | [`envelope`](wire::envelope) | what opens is its own header, payload and trailer, and a changed byte closes it |
//! | [`frame`](wire::frame) | any bytes come through a line; what is read as a message is written to the same message |
//! | [`service`](service::service) | every answer of the device is that of a simple model of it |
//! | [`measurements`](readers::measurements), [`targets`](readers::targets), [`import`](readers::import), [`preset`](readers::preset) | refused with the name and a place within the file; what is taken is finite, with unit quaternions |
//! | [`urdf`](readers::urdf), [`toml`](readers::toml), [`cell`](readers::cell) | the same; what is taken has 1 to 8 joints and rigid frames |
//! | [`touches`](readers::touches) | the same, in either of two files; what is taken is finite, and every index is that of an entry |
//! | [`rapid`](programs::rapid), [`urscript`](programs::urscript), [`fanuc`](programs::fanuc), [`krl`](programs::krl), [`inform`](programs::inform), [`val3`](programs::val3), [`table`](programs::table) | the same; the numbers of targets do not overlap, and replacing them changes no other byte |
//! | [`rsi`](bridge::rsi) | only what can be read is answered, with its own time stamp; no correction is above its limit or steps above its ramp |
//! | [`report`](page::report) | whatever is in a name, the page has the tags of one with an ordinary name |
//!
//! [`TARGETS`] lists them for the test of the suite, which makes its inputs from seeds, always the same, and for
//! libFuzzer (`fuzz/`, `tests/fuzz/run`). What once broke a law is kept in `fuzz/regressions`.

pub mod bridge;
mod expected;
pub mod kept;
pub mod mutate;
pub mod page;
pub mod programs;
pub mod readers;
pub mod seeds;
pub mod service;
pub mod wire;

/// What is fuzzed.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name, also of its program and folders in `fuzz/`.
    pub name: &'static str,
    /// Takes one input and panics when a law is broken.
    pub run: fn(&[u8]),
    /// Valid inputs to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Inputs in the suite: a part of a second each.
    pub executions: u64,
}

/// All of them.
#[rustfmt::skip] // a table
pub const TARGETS: [Target; 21] = [
    Target { name: "blob", run: wire::blob, seeds: seeds::blobs, executions: 2_000 },
    Target { name: "envelope", run: wire::envelope, seeds: seeds::blobs, executions: 5_000 },
    Target { name: "frame", run: wire::frame, seeds: seeds::frames, executions: 20_000 },
    Target { name: "service", run: service::service, seeds: seeds::scripts, executions: 1_000 },
    Target { name: "measurements", run: readers::measurements, seeds: seeds::measurements, executions: 5_000 },
    Target { name: "targets", run: readers::targets, seeds: seeds::measurements, executions: 5_000 },
    Target { name: "import", run: readers::import, seeds: seeds::imports, executions: 3_000 },
    Target { name: "preset", run: readers::preset, seeds: seeds::raws, executions: 600 },
    Target { name: "urdf", run: readers::urdf, seeds: seeds::urdfs, executions: 2_000 },
    Target { name: "toml", run: readers::toml, seeds: seeds::tomls, executions: 2_000 },
    Target { name: "cell", run: readers::cell, seeds: seeds::cells, executions: 2_000 },
    Target { name: "touches", run: readers::touches, seeds: seeds::touches, executions: 3_000 },
    Target { name: "rapid", run: programs::rapid, seeds: seeds::rapid, executions: 2_000 },
    Target { name: "urscript", run: programs::urscript, seeds: seeds::urscript, executions: 2_000 },
    Target { name: "fanuc", run: programs::fanuc, seeds: seeds::fanuc, executions: 2_000 },
    Target { name: "krl", run: programs::krl, seeds: seeds::krl, executions: 2_000 },
    Target { name: "inform", run: programs::inform, seeds: seeds::inform, executions: 2_000 },
    Target { name: "val3", run: programs::val3, seeds: seeds::val3, executions: 2_000 },
    Target { name: "table", run: programs::table, seeds: seeds::table, executions: 2_000 },
    Target { name: "rsi", run: bridge::rsi, seeds: seeds::rsi, executions: 200 },
    Target { name: "report", run: page::report, seeds: seeds::names, executions: 2_000 },
];
