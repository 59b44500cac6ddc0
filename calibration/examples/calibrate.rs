//! From a measurement file to the blob of a device: `cargo run -p poegp-calibration --example calibrate`.

use poegp_calibration::prelude::*;
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};

fn main() -> Result<(), Error> {
    let robot = Robot::load("abb-irb4400-serial", &LoadOptions::default())?;
    // In place of an instrument: an arm with errors, and files of its measured poses.
    let folder = std::env::temp_dir();
    let mut arm = Simulator::new(&robot, Scenario::Paper, &[0.0, 30.0, 60.0], 1);
    for (file, poses) in [("train.csv", 300), ("fresh.csv", 40)] {
        let csv = to_csv(&robot, &arm.measure(poses), false, "simulated");
        std::fs::write(folder.join(file), csv)?;
    }

    let data = Samples::read(folder.join("train.csv"), &robot)?;
    let (config, context) = (Config::new(Method::Poe), FitContext::default());
    let held_out = cross_validate(&robot, &data, &config, 5)?.all.position_mm;
    println!("held-out: {:.3} mm mean", held_out.mean);

    let provenance = Provenance::new(&data, "2026-11-20");
    let made = calibrate_to_blob(&robot, &data, &config, &provenance, &context)?;
    std::fs::write(folder.join("arm.blob"), made.blob.bytes())?;

    let fresh = Samples::read_after(folder.join("fresh.csv"), &robot, data.tools)?;
    let report = verify(&made.blob, &fresh, &VerifyOptions::default())?;
    println!("fresh: {:.3} mm mean", report.errors.position_mm.mean);
    Ok(())
}
