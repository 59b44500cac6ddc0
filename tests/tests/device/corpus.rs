//! The stack over what the fuzzer keeps: every input of its corpus, and the valid ones that it began with, on the device.

use poegp_tests::device::{Device, DeviceError};
use poegp_tests::emulator::Clock;
use poegp_tests::fuzzing::kept::{self, Kept};
use poegp_tests::fuzzing::seeds;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};

/// As for the other tests of the stack, `image.rs`.
const BUDGET: u32 = 22 * 1_024;

fn corpus(target: &str) -> Vec<Vec<u8>> {
    kept::read(Kept::Corpus, target).unwrap()
}

/// Bytes on the line, and models, of any kind: the device answers after each, and its stack stays within the budget.
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
        // As it came when the model is of another arm.
        device.correct(&query).unwrap();
        device.trace(&query).unwrap();
    }
    let lines = [seeds::frames(), corpus("frame"), corpus("envelope")].concat();
    for bytes in &lines {
        device.send_bytes(bytes).unwrap();
        device.send_bytes(&[0]).unwrap();
        // The device complains about what it cannot read: once for each zero in it.
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
    // A key was provisioned among all that, so the first model is not taken any more; some model answers.
    let found = device.evaluate(&query).unwrap();
    let numbers = found.pose.iter().chain(&found.correction);
    assert!(
        numbers.chain([&found.trust]).all(|x| x.is_finite()),
        "{found:?}"
    );
}
