//! Fuzzes the bridge, which corrects a controller live, with arbitrary datagrams.

use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use poegp_trainer::bridge::corrector::{Corrector, Settings};
use poegp_trainer::bridge::message::{self, Setpoint};
use poegp_trainer::bridge::rsi::Rsi;

use crate::workspace;

/// Limit on the correction of an axis, in millionths of a degree.
const LIMIT: i64 = 200_000;
const RAMP: i64 = 20_000;

/// Creates a bridge with the arm of the C examples.
fn bridge() -> Rsi {
    let path = workspace().join("runtime/capi/examples/arm.blob");
    let blob = BlobModel::read(&path).expect("the blob of the C examples");
    let settings = Settings {
        payload_kg: 2.0,
        setpoint: Setpoint::Commanded,
        limit_deg: 1e-6 * LIMIT as f64,
        ramp_deg: 1e-6 * RAMP as f64,
    };
    let commander = Commander::new(&blob).expect("its model");
    Rsi::new(Corrector::new(commander, settings), settings.setpoint)
}

/// Parses the time stamp and the corrections of an answer.
fn parsed(answer: &[u8]) -> (u64, Vec<i64>) {
    let text = std::str::from_utf8(answer).expect("text");
    let (correction, ipoc) = text.split_once("/><IPOC>").expect("two elements");
    let correction = correction.strip_prefix("<Sen Type=\"ImFree\"><AK ");
    let numbers = correction.expect("a correction").split(' ');
    let number = |text: &str| -> i64 {
        let (_, value) = text.split_once("=\"").expect("an attribute");
        let (whole, decimals) = value
            .trim_end_matches('"')
            .split_once('.')
            .expect("decimals");
        assert_eq!(decimals.len(), 6, "{text}");
        format!("{whole}{decimals}").parse().expect("a number")
    };
    let ipoc = ipoc.strip_suffix("</IPOC></Sen>").expect("an end");
    (
        ipoc.parse().expect("a stamp"),
        numbers.map(number).collect(),
    )
}

/// Lets the bridge answer packets that are separated by zeros. Only a readable packet is answered, with its own time stamp;
/// a correction is within its limit, and within one ramp of the previous one or of zero in another session.
///
/// # Panics
/// When a law is broken.
pub fn rsi(bytes: &[u8]) {
    let mut bridge = bridge();
    let mut last = vec![0; 6];
    for datagram in bytes.split(|byte| *byte == 0) {
        let packet = message::read(datagram, Setpoint::Commanded);
        let sessions = bridge.counts().sessions;
        let Some(answer) = bridge.answer(datagram) else {
            continue;
        };
        let (ipoc, correction) = parsed(answer);
        assert_eq!(Some(ipoc), packet.map(|packet| packet.ipoc));
        assert_eq!(correction.len(), 6);
        if bridge.counts().sessions > sessions {
            last.fill(0);
        }
        for (now, before) in correction.iter().zip(&last) {
            assert!(now.abs() <= LIMIT && (now - before).abs() <= RAMP);
        }
        last = correction;
    }
    let counts = bridge.counts();
    let known = counts.cycles + counts.duplicates + counts.late + counts.garbage;
    assert_eq!(counts.received, known);
}
