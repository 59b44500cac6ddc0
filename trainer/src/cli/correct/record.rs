//! The record beside a corrected program: which model corrected which source to which result, with the joints before and
//! after. The program keeps its other bytes unchanged, so that it cannot carry this information itself.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::cli::failure::Failure;
use crate::cli::inputs::file_name;
use crate::cli::output::transaction::folder_of;
use crate::cli::terminal::print::warning;
use crate::robot_programs::correction::engine::Direction;
use crate::robot_programs::correction::program::Program;
use crate::robot_programs::correction::replacement::{Rewritten, Solved};
use crate::robot_programs::correction::target_poses::frames_of;
use poegp_calibration::blob::commander::{Commander, Joints, pose_distance};
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::statistics::evenly_spaced;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::math::se3::Pose;

/// Ending of a record's file name.
const ENDING: &str = ".poegp.json";
/// Size limit of a record, in bytes; a longer file is not a record.
const LONGEST: u64 = 1 << 24;
/// Largest distance in m of targets that were brought back from those that were corrected: what the decimals of a program
/// leave.
const BROUGHT_BACK: f64 = 2e-5;
/// Largest rotation in rad between two targets that are the same.
const SAME_ROTATION: f64 = 1e-4;
/// Largest number of targets in a record, evenly spaced along the program.
const MOST_TARGETS: usize = 1_000;

/// The contents of a record.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Record {
    version: String,
    pub source: String,
    pub model_sha256: String,
    source_sha256: String,
    pub result_sha256: String,
    pub is_inverse: bool,
    /// Name of the robot.
    pub robot: String,
    /// Number of targets that were corrected.
    pub corrected: usize,
    /// The corrected targets, or an even selection of them.
    pub targets: Vec<Target>,
    /// Byte ranges of inserted instructions in the result, which the source does not have: first byte, and one past the
    /// last.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inserted: Vec<(usize, usize)>,
}

/// A corrected target.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Target {
    /// Joints that bring the nominal arm to the target, rad or m.
    pub joints: Vec<f64>,
    /// Joints that are commanded, rad or m.
    pub command: Vec<f64>,
    pub payload_kg: f64,
    /// Position of the tool in the flange frame, m.
    pub tool_m: [f64; 3],
}

/// The model that corrects a program, and the direction.
pub struct Corrector<'a> {
    pub robot: &'a str,
    pub joints: usize,
    pub sha256: &'a str,
    pub direction: Direction,
}

impl Record {
    /// Creates the record of file `index` of a program.
    pub fn new(
        path: &Path,
        corrector: &Corrector<'_>,
        source_sha256: &str,
        (result, inserted): &Rewritten,
        (program, solved, index): (&Program, &[Solved], usize),
    ) -> Self {
        let is_inverse = corrector.direction == Direction::Inverse;
        let own = targets_of(program, solved, index);
        let some = evenly_spaced(&own, MOST_TARGETS).into_iter();
        let joints = |q: &Joints| q[..corrector.joints].iter().map(|q| nanos(*q)).collect();
        let target = |solved: &Solved| Target {
            joints: joints(&solved.joints),
            command: joints(&solved.command),
            payload_kg: solved.payload_kg,
            tool_m: {
                let (tool, _) = frames_of(program, &program.targets[solved.target]);
                [0, 1, 2].map(|i| nanos(tool.translation[i]))
            },
        };
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: file_name(path),
            model_sha256: corrector.sha256.to_owned(),
            source_sha256: source_sha256.to_owned(),
            result_sha256: sha256(result),
            is_inverse,
            robot: corrector.robot.to_owned(),
            corrected: own.len(),
            // A program that was brought back to the nominal model has nothing to compare with a model.
            targets: match is_inverse {
                true => Vec::new(),
                false => some.map(target).collect(),
            },
            inserted: inserted.clone(),
        }
    }

    /// Returns whether the targets of file `index`, brought back, are those that were corrected.
    pub fn is_undone(
        &self,
        commander: &Commander,
        (program, solved, index): (&Program, &[Solved], usize),
    ) -> bool {
        let own = targets_of(program, solved, index);
        // Parts that are left now say so themselves.
        if own.len() != self.corrected {
            return true;
        }
        let is_same = |(found, before): (&Solved, &Target)| {
            let found = commander.nominal_flange(&found.command);
            pose_distance(&found, &flange(commander, &before.joints)).0 < BROUGHT_BACK
        };
        let some = evenly_spaced(&own, MOST_TARGETS);
        some.into_iter().zip(&self.targets).all(is_same)
    }

    /// Returns the corrected targets that differ from the uncorrected ones, as poses of the nominal flange.
    fn corrected_targets(&self, commander: &Commander) -> Vec<Pose<f64>> {
        let moved = |target: &Target| {
            let [before, after] = [&target.joints, &target.command].map(|q| flange(commander, q));
            (pose_distance(&before, &after).0 > 2.0 * BROUGHT_BACK).then_some(after)
        };
        self.targets.iter().filter_map(moved).collect()
    }

    /// Reads a record.
    ///
    /// # Errors
    /// [`InputError`] names the file.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let expected = "a record OUT.poegp.json, which `trainer correct` writes beside a program";
        let bytes =
            std::fs::read(path).map_err(|error| InputError::unreadable(path, &error, expected))?;
        serde_json::from_slice(&bytes)
            .map_err(|error| InputError::new(path, format!("no record: {error}"), expected))
    }
}

/// Returns the pose of the nominal flange at the joints of a record.
fn flange(commander: &Commander, joints: &[f64]) -> Pose<f64> {
    let mut all = [0.0; MAX_JOINTS];
    for (slot, q) in all.iter_mut().zip(joints) {
        *slot = *q;
    }
    commander.nominal_flange(&all)
}

/// Returns the corrected targets of file `index`.
fn targets_of<'a>(program: &Program, solved: &'a [Solved], index: usize) -> Vec<&'a Solved> {
    let is_here = |solved: &&Solved| program.targets[solved.target].location.file == index;
    solved.iter().filter(is_here).collect()
}

/// Rounds to nine decimals: nanometres or nanoradians.
fn nanos(x: f64) -> f64 {
    (1e9 * x).round() * 1e-9
}

/// Returns the path of a program's record, `OUT.poegp.json`.
pub fn record_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(ENDING);
    PathBuf::from(name)
}

/// Whether `bytes`, the contents of the file at `path`, are what a correction wrote there, by the record beside it.
pub fn is_result(path: &Path, bytes: &[u8]) -> bool {
    Record::read(&record_path(path)).is_ok_and(|record| record.result_sha256 == sha256(bytes))
}

/// Returns the program that a record belongs to; `None` if the file name is not that of a record.
pub fn program_of(record: &Path) -> Option<PathBuf> {
    let name = record.file_name()?.to_str()?.strip_suffix(ENDING)?;
    (!name.is_empty()).then(|| record.with_file_name(name))
}

/// Computes the SHA-256 of bytes, as hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// The records beside programs, by folder.
#[derive(Default)]
pub struct Records(HashMap<PathBuf, Vec<(String, Record)>>);

impl Records {
    /// Reads the records of a folder once. Files that are no record are passed over.
    fn of_folder(&mut self, folder: &Path) -> &[(String, Record)] {
        self.0.entry(folder.to_path_buf()).or_insert_with(|| {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            let read = |entry: std::fs::DirEntry| {
                let name = entry.file_name().to_string_lossy().into_owned();
                let data = entry.metadata().ok()?;
                let is_record = name.ends_with(ENDING) && data.is_file() && data.len() <= LONGEST;
                let bytes = is_record.then(|| std::fs::read(entry.path()))?.ok()?;
                let record: Record = serde_json::from_slice(&bytes).ok()?;
                Some((name, record))
            };
            entries.filter_map(read).collect()
        })
    }

    /// Refuses to correct a program that a record in its folder lists as corrected already, and to bring back one that
    /// another model has corrected. Returns the record of the program that is to be brought back, if there is one.
    ///
    /// # Errors
    /// [`InputError`] names the program and the record, and a program's own record that cannot be read.
    pub fn of_corrected(
        &mut self,
        path: &Path,
        bytes: &[u8],
        model: &str,
        direction: Direction,
    ) -> Result<Option<Record>, Failure> {
        let hash = sha256(bytes);
        let is_result = |(_, record): &&(String, Record)| {
            record.result_sha256 == hash && record.source_sha256 != hash && !record.is_inverse
        };
        let Some((name, record)) = self.of_folder(folder_of(path)).iter().find(is_result) else {
            warn_of_change(path, &hash, direction)?;
            return Ok(None);
        };
        let found = format!("a program that was corrected already ({name})");
        match direction {
            Direction::Correct => Err(InputError::new(path, found, "an uncorrected program")
                .with_help(format!(
                    "correct {} instead, or bring this one back with --inverse",
                    original(record, path)
                ))
                .into()),
            Direction::Inverse if record.model_sha256 != model => {
                let found = format!("a program that another model has corrected ({name})");
                Err(InputError::new(path, found, "the model that corrected it").into())
            }
            Direction::Inverse => Ok(Some(record.clone())),
        }
    }

    /// Refuses to correct file `index` of a program if most of its targets are corrected ones of a record in its folder: an
    /// edited copy of a corrected program. If a few are, they are warned of.
    ///
    /// # Errors
    /// [`InputError`] names the program and the record.
    pub fn refuse_copy(
        &mut self,
        path: &Path,
        commander: &Commander,
        (program, solved, index): (&Program, &[Solved], usize),
    ) -> Result<(), InputError> {
        let own: Vec<Pose<f64>> = targets_of(program, solved, index)
            .into_iter()
            .map(|solved| commander.nominal_flange(&solved.joints))
            .collect();
        for (name, record) in self.of_folder(folder_of(path)) {
            let corrected = record.corrected_targets(commander);
            let (known, most) = share_of(&own, &corrected);
            let original = original(record, path);
            // A long program has targets that its record does not list.
            let is_selection = record.corrected > record.targets.len();
            if most || is_selection && share_of(&corrected, &own).1 {
                let found = format!("a program with targets that were corrected already ({name})");
                return Err(InputError::new(path, found, "an uncorrected program").with_help(format!(
                    "make the changes in {original} and correct that, or bring this one back with --inverse"
                )));
            }
            if known > 0 {
                warning(format_args!(
                    "{}: {} corrected already ({name}), and this corrects it twice: copy it from {original} instead",
                    path.display(),
                    match known {
                        1 => "one of its targets was".to_owned(),
                        count => format!("each of {count} targets was"),
                    }
                ));
            }
        }
        Ok(())
    }
}

/// Returns how many of `targets` are among `others`, and whether most are.
fn share_of(targets: &[Pose<f64>], others: &[Pose<f64>]) -> (usize, bool) {
    let mut others: Vec<&Pose<f64>> = others.iter().collect();
    others.sort_by(|a, b| a.translation.x.total_cmp(&b.translation.x));
    let is_there = |target: &&Pose<f64>| {
        let (least, most) = (
            target.translation.x - BROUGHT_BACK,
            target.translation.x + BROUGHT_BACK,
        );
        let first = others.partition_point(|other| other.translation.x < least);
        let mut near = others[first..]
            .iter()
            .take_while(|other| other.translation.x <= most);
        near.any(|other| {
            let (moved, turned) = pose_distance(target, other);
            moved < BROUGHT_BACK && turned < SAME_ROTATION
        })
    };
    let count = targets.iter().filter(is_there).count();
    (count, 2 * count > targets.len())
}

/// Returns the name of the source of a record; with its place, where the corrected program has the same name.
fn original(record: &Record, corrected: &Path) -> String {
    let folder = folder_of(corrected);
    match file_name(corrected) == record.source {
        true => format!(
            "the original {} (not the one in {})",
            record.source,
            folder.display()
        ),
        false => record.source.clone(),
    }
}

/// Warns of a program that is brought back, but was changed since it was corrected: its record no longer says what it was
/// corrected with.
fn warn_of_change(path: &Path, hash: &str, direction: Direction) -> Result<(), InputError> {
    let own = record_path(path);
    if !own.exists() {
        return Ok(());
    }
    let record = Record::read(&own)?;
    if direction == Direction::Inverse && !record.is_inverse && record.source_sha256 != hash {
        warning(format_args!(
            "{}: this program was changed after {} was written; which model, payload and frames corrected it is not \
            checked, and inserted targets stay",
            path.display(),
            own.display()
        ));
    }
    Ok(())
}

/// Warns of programs that are brought back, though no record shows that they were ever corrected. `files` have the hash of
/// each file, and whether the record of a correction with this result was found. A source and its data list are one program.
pub fn warn_of_uncorrected<'a>(files: impl Iterator<Item = (&'a Path, &'a str, bool)>) {
    let mut programs: BTreeMap<PathBuf, (&Path, bool)> = BTreeMap::new();
    for (path, hash, is_found) in files {
        // A file whose own record does not fit was changed, which is said; one without targets is as its record says.
        let own = || Record::read(&record_path(path)).ok();
        let is_of_correction = |record: Record| {
            let is_source = record.source_sha256 == hash && record.result_sha256 != hash;
            !record.is_inverse && !is_source
        };
        let is_known = is_found || own().is_some_and(is_of_correction);
        let entry = programs
            .entry(path.with_extension(""))
            .or_insert((path, false));
        *entry = (path, entry.1 || is_known);
    }
    for (path, is_known) in programs.values() {
        if !is_known {
            warning(format_args!(
                "{}: no record shows that this program was corrected; if it was not, --inverse moves every target in \
                the wrong direction",
                path.display()
            ));
        }
    }
}
