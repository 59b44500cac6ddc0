//! `--region` and `--payload-kg` of `trainer export`.

use std::path::Path;

use poegp_protocol::JointKind;

use crate::cli::failure::Failure;
use crate::cli::inputs::robot_of;
use crate::cli::terminal::print::note;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::region::{Near, NotTrained, Region};
use poegp_calibration::input_error::{InputError, counted, number};
use poegp_calibration::measurement::joint_targets::{OwnTarget, read_targets};
use poegp_calibration::robot::{Robot, in_file_units};

/// Smallest reach, in degrees or millimetres.
const LEAST_REACH: f64 = 1e-3;

/// Default reach of a region around the poses of a file: degrees, or millimetres along prismatic joints.
const REACH: f64 = 2.0;

/// Creates the region that the command line asks for.
pub fn region(
    loaded: &BlobModel,
    asked: Option<&str>,
    payload_kg: Option<f32>,
) -> Result<Region, Failure> {
    let blob = loaded.blob();
    let robot = robot_of(loaded);
    let mut payloads = None;
    let region = match asked {
        None => Region::trained(blob),
        Some(asked) => {
            let (reach, poses) = split(asked)?;
            if let Some(pose) = numbers(poses) {
                let poses = vec![joints(asked, &pose, &robot)?];
                let not_trained = |error| {
                    let [found, expected] = found_and_expected(&robot, &error);
                    Failure::Usage(format!(
                        "--region {asked}: found {found}, expected {expected}"
                    ))
                };
                Region::near(blob, Near { poses, reach }).map_err(not_trained)?
            } else {
                let file = Path::new(poses);
                let (rows, notes) = read_targets(file, &robot)?;
                for text in notes {
                    note(format_args!("{}: {text}", file.display()));
                }
                payloads = of_rows(&rows);
                let poses = rows.iter().map(|row| row.1.clone()).collect();
                let not_trained = |error: NotTrained| {
                    let [found, expected] = found_and_expected(&robot, &error);
                    InputError::new(file, found, expected)
                        .at_line(rows[error.pose].0)
                        .with_help("leave this row out, or measure there and calibrate again")
                };
                Region::near(blob, Near { poses, reach }).map_err(not_trained)?
            }
        }
    };
    let trained = blob.ranges.payload_kg;
    match (
        payload_kg
            .map(|kg| (kg, kg))
            .or(payloads.filter(|_| trained.is_some())),
        trained,
    ) {
        (None, _) => Ok(region),
        (Some((light, heavy)), Some((least, most))) if least <= light && heavy <= most => {
            Ok(region.with_payloads((light, heavy)))
        }
        (Some((light, heavy)), Some((least, most))) => {
            let asked = match payload_kg {
                Some(kg) => format!("--payload-kg {kg}"),
                None => format!(
                    "--region {}: payloads of {light} to {heavy} kg",
                    asked.unwrap_or_default()
                ),
            };
            Err(Failure::Usage(format!(
                "{asked}: {least} to {most} kg were trained"
            )))
        }
        (Some((kg, _)), None) => Err(Failure::Usage(format!(
            "--payload-kg {kg}: the model does not depend on the payload"
        ))),
    }
}

/// Returns the part of `--region` that may be the path of a file.
pub fn file(asked: &str) -> &Path {
    let poses = split(asked).map_or(asked, |(_, poses)| poses);
    Path::new(poses)
}

/// Splits `--region` into the reach before the `@` and the poses behind it.
fn split(asked: &str) -> Result<(f64, &str), Failure> {
    let parts = asked
        .split_once('@')
        .map(|(reach, poses)| (reach, reach.parse::<f64>(), poses));
    match parts {
        Some((_, Ok(_), "")) => Err(Failure::Usage(format!(
            "--region {asked}: found no poses, expected joint values or a CSV file after the @"
        ))),
        Some((_, Ok(reach), poses)) if reach >= LEAST_REACH && reach.is_finite() => {
            Ok((reach, poses))
        }
        Some((text, Ok(_), _)) => Err(Failure::Usage(format!(
            "--region {asked}: found {text} before the @, expected degrees, {LEAST_REACH} or more"
        ))),
        _ if numbers(asked).is_some_and(|all| all.len() > 1) => Err(Failure::Usage(format!(
            "--region {asked}: found a pose alone, expected degrees and @ before it, as in 15@{asked}"
        ))),
        _ => Ok((REACH, asked)),
    }
}

/// Parses finite numbers with commas between them.
fn numbers(text: &str) -> Option<Vec<f64>> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    text.split(',').map(number).collect()
}

/// Converts a pose of the command line from degrees and millimetres to rad and m.
fn joints(asked: &str, pose: &[f64], robot: &Robot) -> Result<Vec<f64>, Failure> {
    if pose.len() != robot.joints.len() {
        return Err(Failure::Usage(format!(
            "--region {asked}: found {}, expected those of the {} of {}",
            counted(pose.len(), "joint value"),
            counted(robot.joints.len(), "joint"),
            robot.name
        )));
    }
    let values = pose.iter().zip(&robot.joints);
    Ok(values
        .map(|(value, joint)| match joint.kind {
            JointKind::Revolute => value.to_radians(),
            JointKind::Prismatic => 1e-3 * value,
        })
        .collect())
}

/// Returns the lightest and the heaviest payload of the rows; `None` unless every row has one.
fn of_rows(rows: &[OwnTarget]) -> Option<(f32, f32)> {
    let payloads: Option<Vec<f32>> = rows.iter().map(|row| row.2.map(|kg| kg as f32)).collect();
    let payloads = payloads?;
    let light = payloads.iter().copied().fold(f32::INFINITY, f32::min);
    let heavy = payloads.iter().copied().fold(0.0, f32::max);
    Some((light, heavy))
}

/// Says which joint of a pose is outside its trained range.
fn found_and_expected(robot: &Robot, error: &NotTrained) -> [String; 2] {
    let joint = &robot.joints[error.joint];
    let unit = match joint.kind {
        JointKind::Revolute => "°",
        JointKind::Prismatic => " mm",
    };
    let text = |value| {
        let value = in_file_units(joint.kind, value);
        number((value * 1e4).round() / 1e4 + 0.0)
    };
    let (lower, upper) = error.trained;
    [
        format!("joint {} at {}{unit}", error.joint + 1, text(error.value)),
        format!(
            "its trained range, {} to {}{unit}",
            text(lower),
            text(upper)
        ),
    ]
}
