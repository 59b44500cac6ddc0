//! The bits of the golden files, from whatever processor this is built for.
//!
//! Evaluates the runtime at the queries of `tests/data/golden_*_bits.txt` and prints what it found in the words of those
//! files, so that a comparison of texts is one of bits: of each case all stages (`bits`), then trust and standard
//! deviation (`trust`), then the corrected commands (`command`). `tests/machines/run` builds, runs and compares it.
//!
//! With an operating system it is an ordinary program, whose argument N makes it take every N-th query. Without one it is
//! the whole image of an emulated machine: a start of some instructions (`start.rs`), no interrupts, and a debugger's
//! channel (semihosting) for the text and the end.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![deny(unsafe_code)]

mod answers;
#[cfg(target_os = "none")]
mod start;

/// Every query, or every so many.
#[cfg(not(target_os = "none"))]
fn main() {
    let every = match std::env::args().nth(1).map(|text| text.parse()) {
        None => 1,
        Some(Ok(every)) if every > 0 => every,
        Some(_) => {
            eprintln!("error: the argument is a whole number N > 0: every N-th query");
            std::process::exit(2);
        }
    };
    if let Err(problem) = answers::print(every, |line| println!("{line}")) {
        eprintln!("error: {problem}");
        std::process::exit(1);
    }
}
