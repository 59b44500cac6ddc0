//! Inputs of the fuzzer, for `tests/fuzz/run`. `corpus unpack FOLDER` writes the valid inputs of every target and what is
//! kept in `fuzz/` into `FOLDER/TARGET`; `corpus pack FOLDER TARGET…` keeps what is in `FOLDER/TARGET`.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use poegp_tests::fuzzing::TARGETS;
use poegp_tests::fuzzing::kept::{self, Kept};

fn main() -> io::Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["unpack", folder] => unpack(Path::new(folder)),
        ["pack", folder, ref targets @ ..] => targets
            .iter()
            .try_for_each(|target| pack(&Path::new(folder).join(target), target)),
        _ => Err(io::Error::other(
            "usage: corpus unpack FOLDER | corpus pack FOLDER TARGET…",
        )),
    }
}

fn unpack(folder: &Path) -> io::Result<()> {
    for target in TARGETS {
        let folder = folder.join(target.name);
        fs::create_dir_all(&folder)?;
        let inputs = [
            ("valid", (target.seeds)()),
            ("corpus", kept::read(Kept::Corpus, target.name)?),
            ("regression", kept::read(Kept::Regressions, target.name)?),
        ];
        for (what, inputs) in inputs {
            for (number, bytes) in inputs.iter().enumerate() {
                fs::write(folder.join(format!("{what}-{number:03}")), bytes)?;
            }
        }
    }
    Ok(())
}

fn pack(folder: &Path, target: &str) -> io::Result<()> {
    let paths: Vec<PathBuf> = fs::read_dir(folder)?
        .map(|entry| Ok(entry?.path()))
        .collect::<io::Result<_>>()?;
    let inputs = paths.iter().map(fs::read).collect::<io::Result<_>>()?;
    kept::write(Kept::Corpus, target, inputs)
}
