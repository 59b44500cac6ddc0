//! The stack on the device over all inputs of the fuzzer's corpus and over the valid inputs that it began with.

use poegp_tests::device::{Device, DeviceError};
use poegp_tests::emulator::Clock;
use poegp_tests::fuzzing::kept::{self, Kept};
use poegp_tests::fuzzing::seeds;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// The stack budget of the other tests, such as `image.rs`.
const BUDGET: u32 = 22 * 1_024;

fn corpus(target: &str) -> Vec<Vec<u8>> {
    kept::read(Kept::Corpus, target).unwrap()
}

/// For any bytes on the line and any models, the device answers after each, and its stack stays within the budget.
#[test]
fn the_stack_stays_small_over_the_corpus() {
    let mut device = Device::start(Clock::Real).unwrap_or_else(|error| panic!("{error}"));
    let sample = Sample::plain(61, SampleCorrection::Elastic(Elastic::PLAIN));
    let query = sample.queries(1).remove(0);
    device.load(&sample.blob()).unwrap();
    let (mut taken, mut refused) = (0, 0);
    let models = seeds::blobs().into_iter().chain(corpus("blob"));
    for model in models.filter(|bytes| !bytes.is_empty()) {
        match device.load(&model) {
            Ok(_) => taken += 1,
            Err(DeviceError::Refused(_)) => refused += 1,
            Err(error) => panic!("{error}"),
        }
        // If the model is of another arm, the command comes back unchanged.
        device.correct(&query).unwrap();
        device.trace(&query).unwrap();
    }
    let lines = [seeds::frames(), corpus("frame"), corpus("envelope")].concat();
    for bytes in &lines {
        device.send_bytes(bytes).unwrap();
        device.send_bytes(&[0]).unwrap();
        // The device refuses what it cannot read, once for each zero in the input.
        let answered = (0..1_000).any(|_| device.correct(&query).is_ok());
        assert!(answered, "silent after {bytes:02x?}");
    }
    let stack = device.statistics().unwrap().stack_bytes;
    println!(
        "{taken} models taken and {refused} refused, {} inputs of the line: stack {stack} bytes",
        lines.len()
    );
    assert!(taken > 4 && refused > 20 && lines.len() > 100);
    assert!(stack <= BUDGET, "{stack}");
    // The inputs provision a key, so the first model is not accepted any more; some other model answers.
    let found = device.evaluate(&query).unwrap();
    let numbers = found.pose.iter().chain(&found.correction);
    assert!(
        numbers.chain([&found.trust]).all(|x| x.is_finite()),
        "{found:?}"
    );
}
