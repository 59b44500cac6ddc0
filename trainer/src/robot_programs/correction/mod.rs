//! Corrects the targets in existing programs of controllers.
//!
//! A reader finds the numbers of the targets and their positions in the file; the [`engine`] corrects them; only these
//! numbers are written. Every other byte stays: comments, line ends, letters of any encoding. A reader never guesses: what
//! it does not understand, it leaves as it is and names.

pub mod between;
pub mod engine;
mod fanuc;
mod fanuc_configuration;
mod fanuc_frames;
mod fanuc_numbers;
mod fanuc_settings;
mod flow;
pub mod frames;
mod held;
mod inform;
mod inform_conditions;
mod krl;
pub mod planning;
pub mod posture;
pub mod program;
mod rapid;
pub mod replacement;
pub mod seeds;
mod solution;
pub mod source;
pub mod split;
mod table;
mod table_columns;
pub mod target_poses;
pub mod tokens;
mod unfound;
mod urscript;
mod val3;
mod wanted;

use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;

use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::Program;
use crate::robot_programs::correction::source::Source;

/// A program format whose targets can be corrected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// ABB: modules.
    Rapid,
    /// Universal Robots: a script.
    UrScript,
    /// Fanuc: a listing.
    Fanuc,
    /// KUKA: a source and its data list.
    Krl,
    /// Yaskawa: a job.
    Inform,
    /// Stäubli: data, and the programs that use them.
    Val3,
    /// A table of poses.
    Table,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 7] = [
        Self::Rapid,
        Self::UrScript,
        Self::Fanuc,
        Self::Krl,
        Self::Inform,
        Self::Val3,
        Self::Table,
    ];

    /// Returns the endings of the format's files, in lower case.
    pub fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Rapid => &["mod", "prg", "sys", "modx", "sysx"],
            Self::UrScript => &["script", "urscript"],
            Self::Fanuc => &["ls"],
            Self::Krl => &["src", "dat"],
            Self::Inform => &["jbi"],
            Self::Val3 => &["dtx"],
            Self::Table => &["csv"],
        }
    }

    /// Returns the format of a file by its ending; for a table, by its header, too: a table of joints is no program.
    pub fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        Self::ALL
            .into_iter()
            .find(|format| format.endings().contains(&ending.as_str()))
            .filter(|format| *format != Self::Table || table::has_poses(path))
    }

    /// Returns whether a file states the payload of each of its targets in a column.
    pub fn has_payloads(self, path: &Path) -> bool {
        self == Self::Table && table::has_payloads(path)
    }

    /// Returns the path of the data list beside a source, which belongs to the program.
    pub fn companion(self, path: &Path) -> Option<PathBuf> {
        let ending = path.extension()?.to_str()?;
        let other = match (self, ending) {
            (Self::Krl, "src") => "dat",
            (Self::Krl, "SRC") => "DAT",
            _ => return None,
        };
        Some(path.with_extension(other)).filter(|path| path.exists())
    }

    /// Returns the files beside a file that say how its targets are used or what its frames are; they are not corrected.
    pub fn beside(self, path: &Path) -> Vec<PathBuf> {
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let Ok(entries) = std::fs::read_dir(folder) else {
            return Vec::new();
        };
        let is_used = |path: &PathBuf| match self {
            Self::Val3 => path
                .extension()
                .is_some_and(|ending| ending.eq_ignore_ascii_case("pgx")),
            Self::Inform => is_named(path, &inform_conditions::NAMES),
            Self::Fanuc => is_named(path, &fanuc_frames::NAMES),
            _ => false,
        };
        let paths = entries
            .flatten()
            .map(|entry| folder.join(entry.file_name()));
        let mut found: Vec<PathBuf> = paths.filter(is_used).collect();
        found.sort();
        found
    }

    /// Reads the files of one program.
    ///
    /// # Errors
    /// [`InputError`] for a frame that is nowhere, and for what is no program of this format.
    pub fn read(self, sources: Vec<Source>, frames: &FrameFile) -> Result<Program, InputError> {
        match self {
            Self::Rapid => rapid::read(sources, frames),
            Self::UrScript => urscript::read(one(sources)?, frames),
            Self::Fanuc => {
                let (listing, others) = with_others(sources)?;
                fanuc::read(listing, &others, frames)
            }
            Self::Krl => krl::read(sources, frames),
            Self::Inform => {
                let (job, others) = with_others(sources)?;
                inform::read(job, &others, frames)
            }
            Self::Val3 => val3::read(sources, frames),
            Self::Table => table::read(one(sources)?, frames),
        }
    }
}

/// Returns whether a file has one of these names; upper and lower case are equal.
fn is_named(path: &Path, names: &[&str]) -> bool {
    let name = path.file_name();
    name.is_some_and(|name| names.iter().any(|known| name.eq_ignore_ascii_case(known)))
}

/// Returns the only file that is corrected, and the files that are read with it.
fn with_others(sources: Vec<Source>) -> Result<(Source, Vec<Source>), InputError> {
    let (corrected, others): (Vec<_>, Vec<_>) =
        sources.into_iter().partition(|source| source.is_corrected);
    Ok((one(corrected)?, others))
}

/// Returns the only file of a program, and refuses several.
fn one(mut sources: Vec<Source>) -> Result<Source, InputError> {
    match (sources.pop(), sources.last()) {
        (Some(source), None) => Ok(source),
        (last, _) => {
            let path = last.map_or_else(Default::default, |source| source.path);
            Err(InputError::new(
                path,
                "a second file",
                "one file, which is a whole program",
            ))
        }
    }
}
