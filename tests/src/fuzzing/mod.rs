//! Fuzz targets for every reader of input: each is a function that takes arbitrary bytes and panics when a law is broken.
//!
//! | target | law beyond "no panic" |
//! |---|---|
//! | [`blob`](wire::blob) | a rejected blob leaves the present model unchanged; with an accepted one every answer is finite, no joint is corrected by more than the bound, and writing and reading it again gives the same blob |
//! | [`envelope`](wire::envelope) | an envelope that opens consists of exactly its header, payload and trailer, and does not open after a changed byte |
//! | [`frame`](wire::frame) | any bytes can be sent over a line; a message that was read is written as the same message |
//! | [`service`](service::service) | every answer of the device is that of a simple model of it |
//! | [`measurements`](readers::measurements), [`targets`](readers::targets), [`import`](readers::import), [`preset`](readers::preset) | an error names the file and a position within it; accepted data are finite, with unit quaternions |
//! | [`urdf`](readers::urdf), [`toml`](readers::toml), [`cell`](readers::cell) | errors as for measurements; accepted data have 1 to 8 joints and rigid frames |
//! | [`touches`](readers::touches) | errors as for measurements, in either of two files; accepted data are finite, and every index is that of an entry |
//! | [`rapid`](programs::rapid), [`urscript`](programs::urscript), [`fanuc`](programs::fanuc), [`krl`](programs::krl), [`inform`](programs::inform), [`val3`](programs::val3), [`table`](programs::table) | errors as for measurements; the numbers of targets do not overlap, and replacing them changes no other byte |
//! | [`rsi`](bridge::rsi) | only a readable packet is answered, with its own time stamp; no correction exceeds its limit, and no step exceeds the ramp |
//! | [`report`](page::report) | whatever a name contains, the page has the same tags as with an ordinary name |
//!
//! [`TARGETS`] lists them for the test of the suite, which makes its inputs reproducibly from seeds, and for libFuzzer
//! (`fuzz/`, `tests/fuzz/run`). Inputs that once broke a law are kept in `fuzz/regressions`.

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

/// A fuzz target.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name of the target, and of its program and folders in `fuzz/`.
    pub name: &'static str,
    /// Function that takes one input and panics when a law is broken.
    pub run: fn(&[u8]),
    /// Function that returns valid inputs to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Number of inputs in the test suite, chosen so that each target takes less than a second.
    pub executions: u64,
}

/// All fuzz targets.
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
