//! The command that comes after the measurement.

use std::path::Path;

use crate::cli::args::{Gravity, RobotArgs};
use crate::cli::examination::GRAVITY;

/// Returns the command that calibrates with the measured rows, for the shell.
pub fn calibrate(
    robot: &RobotArgs,
    gravity: Gravity,
    out: &Path,
    features: Option<&Path>,
) -> String {
    let path = |path: &Path| quoted(&path.display().to_string());
    let mut command = format!(
        "trainer calibrate --robot {} {}",
        quoted(&robot.robot),
        path(out)
    );
    let mut add = |option: &str, value: Option<String>| {
        if let Some(value) = value {
            command += &format!(" {option} {value}");
        }
    };
    add("--base", robot.chain.base.as_deref().map(quoted));
    add("--tip", robot.chain.tip.as_deref().map(quoted));
    let [x, y, z] = gravity.0;
    add(
        "--gravity",
        (gravity.0 != GRAVITY).then(|| format!("{x},{y},{z}")),
    );
    add("--features", features.map(path));
    command
}

/// Returns a text as one argument of a command.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./\\:,=@%+~".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    // Every shell knows double quotes; single ones also hold what means something between those.
    match text.contains(['"', '$', '`', '\\', '!']) {
        true => format!("'{}'", text.replace('\'', "'\\''")),
        false => format!("\"{text}\""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::ChainArgs;

    #[test]
    fn every_option_that_matters_is_in_the_command() {
        let mut robot = RobotArgs {
            robot: "ur10".to_owned(),
            chain: ChainArgs {
                base: None,
                tip: None,
            },
        };
        let out = Path::new("m.csv");
        assert_eq!(
            calibrate(&robot, Gravity(GRAVITY), out, None),
            "trainer calibrate --robot ur10 m.csv"
        );
        robot.robot = "my arm.urdf".to_owned();
        robot.chain.base = Some("base_link".to_owned());
        robot.chain.tip = Some("tool0".to_owned());
        let features = Some(Path::new("the $5 plan's.toml"));
        assert_eq!(
            calibrate(&robot, Gravity([0.0, -9.81, 0.0]), out, features),
            "trainer calibrate --robot \"my arm.urdf\" m.csv --base base_link --tip tool0 --gravity 0,-9.81,0 --features \
             'the $5 plan'\\''s.toml'"
        );
    }
}
