//! `trainer evaluate`.
use super::Failure;
use super::arguments::Evaluate;
pub fn run(_a: &Evaluate) -> Result<(), Failure> {
    Ok(())
}
