//! `trainer calibrate`.
use super::Failure;
use super::arguments::Calibrate;
pub fn run(_a: &Calibrate) -> Result<(), Failure> {
    Ok(())
}
