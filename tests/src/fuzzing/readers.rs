//! Fuzzes the readers of files that people and programs write with arbitrary bytes.

use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement as measurement_files;
use poegp_calibration::measurement::JointChecks;
use poegp_calibration::measurement::joint_targets::{NewFields, Target, TargetReader};
use poegp_calibration::measurement::touch::{FeatureKind, Reading, TouchSet};
use poegp_calibration::measurement::{Measurement, MeasurementSet};
use poegp_calibration::planning::constraints::Constraints;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::math::se3::Pose;
use poegp_trainer::import::column_map::Map;
use poegp_trainer::import::import_bytes;
use poegp_trainer::import::preset::{PRESETS, Preset};

/// Largest number of rows and columns of a sheet.
const SHEET: (usize, usize) = (1 << 20, 1 << 14);

/// Returns whether the file is a workbook, whose lines are rows of a sheet.
fn is_workbook(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

/// Checks that an error names one of the files and a position in it, and that its message is not too long.
pub(super) fn assert_refusal(error: &InputError, files: &[(&str, &[u8])]) {
    let message = error.to_string();
    assert!(message.len() < 20_000, "{} bytes", message.len());
    assert!(
        !error.found.is_empty() && !error.expected.is_empty(),
        "{message}"
    );
    let named = |(name, _): &&(&str, &[u8])| error.file == Path::new(name);
    let (_, bytes) = files
        .iter()
        .find(named)
        .unwrap_or_else(|| panic!("the error names no file: {message}"));
    // In UTF-16 a line end has two bytes, one of which is this one.
    let lines = match is_workbook(bytes) {
        true => SHEET.0,
        false => 1 + bytes.iter().filter(|byte| b"\n\r".contains(byte)).count(),
    };
    if let Some(line) = error.line {
        assert!((1..=lines).contains(&line), "{lines} lines: {message}");
    }
    if let Some((column, _)) = error.column {
        let columns = match is_workbook(bytes) {
            true => SHEET.1,
            false => bytes.len() + 1,
        };
        assert!(
            (1..=columns).contains(&column),
            "{} bytes: {message}",
            bytes.len()
        );
    }
}

fn assert_measurement(row: &Measurement) {
    assert!(row.joints.iter().all(|value| value.is_finite()));
    assert!(row.position.iter().all(|value| value.is_finite()));
    assert!(row.payload_kg.is_none_or(|kg| kg.is_finite() && kg >= 0.0));
    if let Some((w, v)) = row.orientation {
        let norm = (w * w + v.norm_squared()).sqrt();
        assert!((norm - 1.0).abs() < 1e-12, "{norm}");
    }
}

fn assert_set(set: &MeasurementSet) {
    assert!(!set.measurements.is_empty());
    for row in &set.measurements {
        assert_eq!(row.joints.len(), set.joint_count());
        assert_measurement(row);
    }
    // Checked against an arm with six joints: the result is notes or a refusal.
    let _ = set.check(&six_axes());
}

/// Returns the arm for which files of joints are read.
pub fn six_axes() -> Robot {
    thread_local! {
        static ROBOT: Robot = Robot::load("abb-irb120", &LoadOptions::default()).expect("built in");
    }
    ROBOT.with(Clone::clone)
}

/// Reads a measurement file.
///
/// # Panics
/// When a law is broken.
pub fn measurements(bytes: &[u8]) {
    let name = "measured.csv";
    match measurement_files::parse(name, bytes) {
        Err(error) => assert_refusal(&error, &[(name, bytes)]),
        Ok(set) => assert_set(&set),
    }
}

/// Reads a file of joint targets.
///
/// # Panics
/// When a law is broken.
pub fn targets(bytes: &[u8]) {
    let name = "targets.csv";
    if let Err(error) = read_targets(Path::new(name), bytes) {
        assert_refusal(&error, &[(name, bytes)]);
    }
}

/// Reads and rewrites all rows of a file.
fn read_targets(path: &Path, bytes: &[u8]) -> Result<(), Box<InputError>> {
    let (columns, start, mut chunks) = TargetReader::new(path, bytes)?.into_parts();
    let robot = six_axes();
    let limits = columns.limits(&robot)?;
    let (mut text, mut checks) = (String::new(), JointChecks::default());
    columns.rewrite_start(&start, &["new"], &mut text)?;
    while let Some(chunk) = chunks.next()? {
        let answer = |row: &Target<'_>| {
            assert!(row.joints.iter().all(|value| value.is_finite()));
            assert!(row.payload_kg.is_none_or(|kg| kg.is_finite()));
            Unchanged
        };
        columns.rewrite(&chunk, (&limits, &mut checks), answer, &mut text)?;
    }
    let _ = limits.notes(&checks);
    Ok(())
}

/// A rewriter that keeps the rows and adds a new field.
struct Unchanged;

impl NewFields for Unchanged {
    fn joint(&self, _: usize, _: &mut String) -> bool {
        false
    }

    fn added(&self, out: &mut String) {
        out.push('0');
    }
}

/// Splits bytes into parts that are separated by zeros.
pub(super) fn parts(bytes: &[u8], most: usize) -> Vec<Vec<u8>> {
    bytes
        .splitn(most, |byte| *byte == 0)
        .map(<[u8]>::to_vec)
        .collect()
}

/// Imports one or two files with a map; the input is the map and the files, separated by zeros.
///
/// # Panics
/// When a law is broken.
pub fn import(bytes: &[u8]) {
    let mut parts = parts(bytes, 3);
    let map = parts.remove(0);
    let text = String::from_utf8_lossy(&map).into_owned();
    run_import(&text, &parts);
}

const MAP: &str = "map.toml";
const RAWS: [&str; 2] = ["one.txt", "two.txt"];

fn run_import(text: &str, raws: &[Vec<u8>]) {
    let map = match Map::parse(Path::new(MAP), text) {
        Err(error) => return assert_refusal(&error, &[(MAP, text.as_bytes())]),
        Ok(map) => map,
    };
    let names: Vec<PathBuf> = RAWS[..raws.len()].iter().map(PathBuf::from).collect();
    match import_bytes(&names, raws, &[&map], false) {
        Ok(imported) => {
            let set = measurement_files::parse("imported.csv", imported.csv.as_bytes());
            let set = set.expect("what was imported");
            assert_eq!(set.measurements.len(), imported.rows.len());
            assert_set(&set);
        }
        // The imported rows are not a valid measurement file: the position is one in the file that would have been written.
        Err(error) if error.file == Path::new("<imported>") => {}
        Err(error) => {
            let mut files = vec![(MAP, text.as_bytes())];
            files.extend(RAWS.into_iter().zip(raws.iter().map(Vec::as_slice)));
            assert_refusal(&error, &files);
        }
    }
}

/// Imports one or two files with every preset, and determines which preset fits.
///
/// # Panics
/// When a law is broken.
pub fn preset(bytes: &[u8]) {
    // Two zeros separate files, because a single zero can be half of a letter in UTF-16.
    let split = bytes.windows(2).position(|pair| pair == [0, 0]);
    let raws = match split {
        Some(at) => vec![bytes[..at].to_vec(), bytes[at + 2..].to_vec()],
        None => vec![bytes.to_vec()],
    };
    let files: Vec<(&Path, &[u8])> = RAWS
        .iter()
        .map(Path::new)
        .zip(raws.iter().map(Vec::as_slice))
        .collect();
    let named: Vec<_> = RAWS
        .into_iter()
        .zip(raws.iter().map(Vec::as_slice))
        .collect();
    for preset in PRESETS {
        match preset.maps(&files) {
            Err(error) => assert_refusal(&error, &named),
            Ok(maps) => {
                let parsed = |(map, _): &(String, _)| {
                    Map::parse(Path::new(MAP), map).unwrap_or_else(|e| panic!("{e}\n{map}"))
                };
                maps.iter().for_each(|map| drop(parsed(map)));
                run_import(&maps[0].0, &raws);
                for error in maps.iter().filter_map(|(_, doubt)| doubt.as_ref()) {
                    assert_refusal(error, &named);
                }
            }
        }
    }
    let chosen = Preset::matching(files[0].0, files[0].1);
    assert!(chosen.is_none_or(|preset| preset.maps(&files[..1]).is_ok()));
}

/// Reads a URDF.
///
/// # Panics
/// When a law is broken.
pub fn urdf(bytes: &[u8]) {
    robot("arm.urdf", bytes);
}

/// Reads a robot description in TOML.
///
/// # Panics
/// When a law is broken.
pub fn toml(bytes: &[u8]) {
    robot("arm.toml", bytes);
}

fn robot(file: &str, bytes: &[u8]) {
    match Robot::parse(Path::new(file), bytes, &LoadOptions::default()) {
        Err(error) => assert_refusal(&error, &[(file, bytes)]),
        Ok(robot) => {
            let joints = robot.joints.len();
            assert!((1..=MAX_JOINTS).contains(&joints));
            assert_eq!(robot.parent_from_joint.len(), joints + 1);
            for frame in &robot.parent_from_joint {
                assert!(is_rigid(frame), "{frame:?}");
            }
            for joint in &robot.joints {
                let sound =
                    |(low, high): (f64, f64)| low <= high && low.is_finite() && high.is_finite();
                assert!(joint.limits.is_none_or(sound), "{joint:?}");
            }
            let rows = robot.coupling.iter().flatten();
            for row in rows {
                assert_eq!(row.len(), joints);
                assert!(row.iter().all(|value| value.is_finite()));
            }
        }
    }
}

fn is_rigid(frame: &Pose<f64>) -> bool {
    let unit = frame.rotation * frame.rotation.transpose();
    let identity = Pose::<f64>::identity().rotation;
    frame.translation.iter().all(|value| value.is_finite())
        && (unit - identity).iter().all(|value| value.abs() < 1e-9)
}

/// Reads the constraints of a plan.
///
/// # Panics
/// When a law is broken.
pub fn cell(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    let name = "cell.toml";
    if let Err(error) = Constraints::parse(Path::new(name), text, &six_axes()) {
        assert_refusal(&error, &[(name, bytes)]);
    }
}

/// Reads touches: the description of the features, a zero byte, and the rows.
///
/// # Panics
/// When a law is broken.
pub fn touches(bytes: &[u8]) {
    let mut parts = bytes.splitn(2, |byte| *byte == 0);
    let (features, rows) = (parts.next().unwrap_or(&[]), parts.next().unwrap_or(&[]));
    let names = ["touches.csv", "touches.toml"];
    let parsed = TouchSet::parse(
        (Path::new(names[0]), rows),
        (Path::new(names[1]), features),
        &six_axes(),
    );
    let set = match parsed {
        Err(error) => {
            return assert_refusal(&error, &[(names[0], rows), (names[1], features)]);
        }
        Ok(set) => set,
    };
    for row in &set.rows {
        assert!(row.joints.iter().all(|q| q.is_finite()), "{row:?}");
        assert!(row.tip < set.tips.len(), "{row:?}");
        let feature = row.reading.feature();
        assert!(feature.is_none_or(|f| f < set.features.len()), "{row:?}");
        assert!(set.sigma(row).is_none_or(|sigma| sigma > 0.0), "{row:?}");
        match row.reading {
            Reading::Level { gravity, .. } => assert!((gravity.norm() - 1.0).abs() < 1e-9),
            Reading::Board {
                feature, corner, ..
            } => match &set.features[feature].kind {
                FeatureKind::Board(board) => assert!(corner < board.corners.len(), "{row:?}"),
                kind => panic!("a corner of {kind:?}"),
            },
            _ => {}
        }
    }
    for known in &set.distances {
        let [a, b] = known.between;
        assert!(a != b && a < set.features.len() && b < set.features.len());
        assert!(known.distance > 0.0 && known.sigma > 0.0, "{known:?}");
    }
}
