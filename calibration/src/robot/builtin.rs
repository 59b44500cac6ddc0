//! The arms that the trainer knows by name.
//!
//! Each has a description like a user's own (`calibration/robots/NAME.toml`, also a good template for a new one) and is
//! parsed by the same reader.

/// Names of the built-in arms, for [`Robot::load`](super::Robot::load).
///
/// `abb-irb4400` takes the controller's joints (the arm has a parallelogram: q3_serial = q3 − q2), `abb-irb4400-serial`
/// takes those of the serial chain.
pub const BUILT_IN: [&str; 6] = [
    "abb-irb120",
    "abb-irb4400",
    "abb-irb4400-serial",
    "kuka-iiwa7",
    "ur10",
    "ur5",
];

/// Returns the description of a built-in arm.
pub(super) fn text(name: &str) -> Option<&'static str> {
    Some(match name {
        "abb-irb120" => include_str!("../../robots/abb-irb120.toml"),
        "abb-irb4400" => include_str!("../../robots/abb-irb4400.toml"),
        "abb-irb4400-serial" => include_str!("../../robots/abb-irb4400-serial.toml"),
        "kuka-iiwa7" => include_str!("../../robots/kuka-iiwa7.toml"),
        "ur10" => include_str!("../../robots/ur10.toml"),
        "ur5" => include_str!("../../robots/ur5.toml"),
        _ => return None,
    })
}
