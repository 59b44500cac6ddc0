//! `trainer simulate`.
use super::Failure;
use super::arguments::Simulate;
pub fn run(_a: &Simulate) -> Result<(), Failure> {
    Ok(())
}
