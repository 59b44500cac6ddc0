//! `cargo run --release -p poegp-tests --example device_demo [SEED]`: builds the firmware, starts it in QEMU, and has a
//! simulated arm execute the commands that it corrects.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(1), |text| text.parse())?;
    poegp_tests::demo::run(seed, &mut std::io::stdout()).map(|_| ())
}
