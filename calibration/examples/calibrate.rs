//! From a measurement file to the blob of a device: `cargo run --example calibrate`.

use poegp_calibration::prelude::*;

const DATA: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../tests/data/simulated/irb4400_paper_s0"
);

fn main() -> Result<(), Error> {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default())?;
    let data = Samples::read(format!("{DATA}_train.csv"), &robot)?;
    let config = Config::new(Method::Poe);
    let context = FitContext::default();

    let held_out = cross_validate(&robot, &data, &config, 5)?.all.position_mm;
    println!(
        "held-out: {:.3} mm mean, {:.3} mm p95",
        held_out.mean, held_out.p95
    );

    let provenance = Provenance::new(&data, "2026-11-20");
    let calibration = calibrate(&robot, &data, &config, &context)?;
    let made = calibration.into_blob(&robot, &data, &provenance, &context)?;
    std::fs::write(std::env::temp_dir().join("arm.blob"), made.blob.bytes())?;

    println!(
        "{:?}",
        made.blob.predict(&data[0].joints, data[0].payload_kg).pose
    );
    let fresh = Samples::read_after(format!("{DATA}_test1.csv"), &robot, data.tools.clone())?;
    let report = verify(&made.blob, &fresh, &VerifyOptions::default())?;
    println!(
        "{:.3} mm mean on fresh measurements",
        report.errors.position_mm.mean
    );
    Ok(())
}
