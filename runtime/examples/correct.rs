//! Corrects one command: what a controller does in every cycle.

use poegp_runtime::{Model400, ModelError, Status};

static BLOB: &[u8] = include_bytes!("arm.blob");

fn main() -> Result<(), ModelError> {
    let mut model = Model400::new();
    model.load(BLOB)?;
    let command = model.correct(&[0.1, -0.4, 0.3, 0.0, 1.2, 0.0], 2.5);
    if command.status.contains(Status::BAD_INPUT) {
        println!("rejected: the joints are sent as they came");
    }
    println!("{:?} rad, {}", &command.joints[..6], command.status);
    Ok(())
}
