//! Finds one joint whose zero differs from that of the nominal model, by any angle.
//!
//! Base and tools are fitted with one such zero at a time. Those of the first and the last joint are not determined: base and
//! tools absorb them.

use poegp_protocol::JointKind;

use crate::identification::alignment::{Alignment, Row, realign};
use crate::measurement::sample::InstrumentSample;
use crate::numeric::statistics::evenly_spaced;
use crate::trust::nominal_fit::{AS_GOOD, Fit, MOST, spread};
use crate::trust::readings::Data;
use crate::trust::wording::fits_equally;

/// Largest zero that is searched for, and the distance of those that are tried first, in rad.
const LARGEST: f64 = 0.26;
const APART: f64 = 0.04;
/// Precision of a zero in rad.
const FINE: f64 = 2e-5;
/// Most rows by which a zero is searched for.
const SEARCHED: usize = 60;
/// Ratio of a section of the golden search to the whole.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

/// A joint zero that explains the poses, and the fit with it.
pub struct JointZero {
    /// Index of the joint.
    joint: usize,
    /// Angle in rad that has to be added to the joint's column.
    offset: f64,
    /// Base and tools with it.
    pub fit: Fit,
    /// Other zeros that explain the poses as well: index of the joint and angle in rad.
    others: Vec<(usize, f64)>,
}

impl JointZero {
    /// States the zero, without a full stop.
    pub fn sentence(&self) -> String {
        let of = |(joint, offset): (usize, f64)| {
            format!(
                "the zero of joint {} looks {:.2}° off (its column reads too {})",
                joint + 1,
                offset.to_degrees().abs(),
                if offset < 0.0 { "high" } else { "low" }
            )
        };
        let others: Vec<String> = self.others.iter().map(|other| of(*other)).collect();
        of((self.joint, self.offset)) + &fits_equally(&others)
    }

    /// Returns the samples with the joint's zero put right.
    pub fn put_right(&self, data: &Data<'_>) -> Vec<InstrumentSample> {
        let of = |sample: &&InstrumentSample| {
            let mut out = (*sample).clone();
            out.joints[self.joint] += self.offset;
            out.serial_joints = data.robot.serial_joints(&out.joints);
            out
        };
        data.samples.iter().map(of).collect()
    }
}

/// Returns the joint zero that explains the poses best, with base and tools fitted. `given` is the fit without it, and `reach`
/// is that of the arm in m.
pub fn joint_zero(data: &Data<'_>, given: &Fit, reach: f64) -> Option<JointZero> {
    let every: Vec<usize> = (0..data.samples.len()).collect();
    let some = evenly_spaced(&every, SEARCHED);
    let is_turned = |j: &usize| data.robot.joints[*j].kind == JointKind::Revolute;
    let of = |joint: usize| {
        let search = Search {
            data,
            rows: &some,
            joint,
        };
        let offset = search.best(&given.alignment);
        let rows = turned(data, &every, joint, offset);
        let fit = Fit::new(realign(given.alignment.clone(), &rows), &rows, reach);
        (joint, offset, fit)
    };
    let mut all: Vec<_> = (0..data.robot.joints.len())
        .filter(is_turned)
        .map(of)
        .collect();
    all.sort_by(|a, b| a.2.relative.total_cmp(&b.2.relative));
    let limit = AS_GOOD * all.first()?.2.relative;
    let others = all[1..].iter().filter(|(_, _, fit)| fit.relative < limit);
    let others = others.map(|(joint, offset, _)| (*joint, *offset)).collect();
    let (joint, offset, fit) = all.swap_remove(0);
    Some(JointZero {
        joint,
        offset,
        fit,
        others,
    })
}

/// Returns rows with an angle in rad added to one joint.
fn turned(data: &Data<'_>, which: &[usize], joint: usize, by: f64) -> Vec<Row> {
    let of = |k: &usize| {
        let sample = data.samples[*k];
        let mut joints = sample.joints.clone();
        joints[joint] += by;
        Row {
            flange: data.chain.forward(&data.robot.serial_joints(&joints)),
            seen: sample.observation,
            tool: sample.tool,
        }
    };
    which.iter().map(of).collect()
}

/// A search for the zero of one joint.
struct Search<'a> {
    data: &'a Data<'a>,
    rows: &'a [usize],
    joint: usize,
}

impl Search<'_> {
    /// Returns the fit with a zero, and what it leaves of most rows.
    fn at(&self, offset: f64, start: &Alignment) -> (f64, Alignment) {
        let rows = turned(self.data, self.rows, self.joint, offset);
        let fit = realign(start.clone(), &rows);
        (fit.length_of_most(&rows, MOST, spread(&rows)), fit)
    }

    /// Returns the best zero, beginning with the fit without one.
    fn best(&self, given: &Alignment) -> f64 {
        let (mut best, mut least, mut start) = (0.0, self.at(0.0, given).0, given.clone());
        for way in [APART, -APART] {
            let (mut offset, mut fit) = (way, given.clone());
            while offset.abs() <= LARGEST {
                let (left, next) = self.at(offset, &fit);
                if left < least {
                    (best, least, start) = (offset, left, next.clone());
                }
                fit = next;
                offset += way;
            }
        }
        let (mut low, mut high) = (best - APART, best + APART);
        let left = |offset: f64| self.at(offset, &start).0;
        let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
        let (mut of_a, mut of_b) = (left(a), left(b));
        while high - low > FINE {
            if of_a < of_b {
                (high, b, of_b) = (b, a, of_a);
                a = high - GOLDEN * (high - low);
                of_a = left(a);
            } else {
                (low, a, of_a) = (a, b, of_b);
                b = low + GOLDEN * (high - low);
                of_b = left(b);
            }
        }
        0.5 * (low + high)
    }
}
