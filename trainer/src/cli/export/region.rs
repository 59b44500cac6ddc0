//! `--region` and `--payload-kg` of `trainer export`.

use std::path::Path;

use poegp_protocol::JointKind;

use crate::cli::failure::Failure;
use crate::cli::inputs::robot_of;
use crate::cli::terminal::print::note;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::region::{Near, NotTrained, Region};
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::joint_targets::{OwnTarget, read_targets};
use poegp_calibration::robot::Robot;

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
                    Failure::Usage(format!("--region {asked}: found {}", found(&robot, &error)))
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
                    InputError::new(
                        file,
                        found(&robot, &error),
                        "poses within the trained ranges",
                    )
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
        .map(|(reach, poses)| (reach.parse::<f64>(), poses));
    match parts {
        Some((Ok(_), "")) => Err(Failure::Usage(format!(
            "--region {asked}: found no poses, expected joint values or a CSV file after the @"
        ))),
        Some((Ok(reach), poses)) if reach > 0.0 && reach.is_finite() => Ok((reach, poses)),
        Some((Ok(reach), _)) => Err(Failure::Usage(format!(
            "--region {asked}: found {reach} before the @, expected degrees above 0"
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
            "--region {asked}: found {} joint values, expected the {} joints of {}",
            pose.len(),
            robot.joints.len(),
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

fn found(robot: &Robot, error: &NotTrained) -> String {
    let (lower, upper) = error.trained;
    let (scale, unit) = match robot.joints[error.joint].kind {
        JointKind::Revolute => (1f64.to_degrees(), "°"),
        JointKind::Prismatic => (1e3, " mm"),
    };
    format!(
        "joint {} at {:.2}{unit}, where {:.2} to {:.2}{unit} were trained",
        error.joint + 1,
        scale * error.value,
        scale * lower,
        scale * upper
    )
}
