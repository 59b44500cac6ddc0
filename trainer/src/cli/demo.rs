//! `trainer demo`.
use super::Failure;
use super::arguments::Demo;
pub fn run(_a: &Demo) -> Result<(), Failure> {
    Ok(())
}
