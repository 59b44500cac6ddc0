//! Corrects commands: what a controller does in every cycle. The filter never sends joints that the model has refused.

use poegp_runtime::filter::{CommandFilter, FilterSettings, Filtered};
use poegp_runtime::{Model400, Status};

static BLOB: &[u8] = include_bytes!("arm.blob");

/// Returns the joints to send, rad. `cycles` is the number of cycles since the last call.
fn cycle(
    model: &Model400,
    filter: &mut CommandFilter<f32>,
    joints_rad: &[f32],
    payload_kg: f32,
    cycles: u32,
) -> Filtered<f32> {
    let payload_kg = filter.payload(payload_kg, cycles);
    let corrected = model.correct(joints_rad, payload_kg);
    filter.step(
        joints_rad,
        &corrected.joints,
        corrected.status,
        true,
        cycles,
    )
}

fn main() -> Result<(), Box<dyn core::error::Error>> {
    let mut model = Model400::new();
    model.load(BLOB)?;
    let mut filter = CommandFilter::new();
    filter.configure(&FilterSettings::with_period(0.001))?;
    let joints_rad = [0.1, -0.4, 0.3, 0.0, 1.2, 0.0];
    let mut sent = cycle(&model, &mut filter, &joints_rad, 2.5, 1);
    while sent.weight < 1.0 {
        sent = cycle(&model, &mut filter, &joints_rad, 2.5, 1);
    }
    println!("{:?} rad, {}", &sent.joints[..6], sent.status);

    // The model's own answer to a joint that is not a number has 0 in its place; the filter repeats the last joints.
    let bad_rad = [0.1, f32::NAN, 0.3, 0.0, 1.2, 0.0];
    let repeated = cycle(&model, &mut filter, &bad_rad, 2.5, 1);
    assert!(repeated.status.contains(Status::BAD_INPUT));
    assert_eq!(repeated.joints, sent.joints);
    println!("{:?} rad, {}", &repeated.joints[..6], repeated.status);
    Ok(())
}

#[test]
fn bad_input_repeats_the_last_joints() {
    main().unwrap();
}
