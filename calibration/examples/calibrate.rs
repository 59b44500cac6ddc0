//! From a measurement file to the blob of a device: `cargo run -p poegp-calibration --example calibrate`.

use poegp_calibration::prelude::*;

const DATA: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../tests/data/simulated/irb4400_paper_s0"
);

fn main() -> Result<(), Error> {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default())?;
    let data = Samples::read(format!("{DATA}_train.csv"), &robot)?;
    let (config, context) = (Config::new(Method::Poe), FitContext::default());

    let held_out = cross_validate(&robot, &data, &config, 5)?.all.position_mm;
    println!("held-out: {:.3} mm mean", held_out.mean);

    let provenance = Provenance::new(&data, "2026-11-20");
    let made = calibrate_to_blob(&robot, &data, &config, &provenance, &context)?;
    std::fs::write(std::env::temp_dir().join("arm.blob"), made.blob.bytes())?;

    let fresh = Samples::read_after(format!("{DATA}_test1.csv"), &robot, data.tools)?;
    let report = verify(&made.blob, &fresh, &VerifyOptions::default())?;
    println!("fresh: {:.3} mm mean", report.errors.position_mm.mean);
    Ok(())
}
