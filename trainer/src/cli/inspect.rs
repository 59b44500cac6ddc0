//! `trainer inspect`.
use super::Failure;
use super::arguments::Inspect;
pub fn run(_a: &Inspect) -> Result<(), Failure> {
    Ok(())
}
