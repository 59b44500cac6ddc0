//! Results for the engineer of a controller: the arm's parameters beside those of the nominal model, and errors with their
//! signs.

use poegp_protocol::JointKind;
use serde::Serialize;

use crate::export::dh::{deviations, numbers, rows_beside_nominal, wrapped};
use crate::export::{CalibratedChain, csv, tables::DhRow};
use crate::report::ReportData;
use poegp_calibration::blob::chain_deviation::ChainDeviation;
use poegp_calibration::blob::joint_offsets::JointOffsets;
use poegp_calibration::blob::live_correction::{COMPLETE_MM, LiveCorrection};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::predicted_poses::PredictedPoses;
use poegp_calibration::blob::region::Region;
use poegp_calibration::identification::prediction_covariance::PredictionCovariance;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::robot::{Joint, Robot};
use poegp_calibration::validation::held_out::HeldOutPose;
use poegp_calibration::validation::signed_residuals::{Row, Signed, SignedResiduals, weights};

/// A parameter of the nominal model and of the calibrated arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Changed {
    /// Value in the nominal model.
    pub nominal: f64,
    /// Value of the calibrated arm.
    pub calibrated: f64,
    /// Calibrated value minus nominal value; an angle is within ±180°.
    pub difference: f64,
    /// Standard deviation of the difference; absent where the model does not state it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub std: Option<f64>,
}

/// A row of the Denavit-Hartenberg table, compared with the nominal model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DhChange {
    /// Name of the joint.
    pub joint: String,
    /// Unit of the signed errors of the joint.
    #[serde(skip)]
    pub residual_unit: &'static str,
    /// Translation along the new x, in mm.
    pub a_mm: Changed,
    /// Translation along z, in mm.
    pub d_mm: Changed,
    /// Rotation about the new x, in degrees.
    pub alpha_deg: Changed,
    /// Rotation about z at joint value 0, in degrees.
    pub theta_deg: Changed,
    /// Rotation about the new y, in degrees: only where the axis is nominally parallel to the one before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beta_deg: Option<Changed>,
}

/// Offset of the zero of a joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointZero {
    /// Name of the joint.
    pub joint: String,
    /// Offset in degrees, for a revolute joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<f64>,
    /// Offset in mm, for a prismatic joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_mm: Option<f64>,
    /// Standard deviation in the unit of the offset; absent where the model does not state it, and for the first and the
    /// last joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub std: Option<f64>,
}

/// Mean distances from the whole model over the trained joint ranges, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// Mean distance of the nominal model with the model's base and tool, in mm.
    pub nominal_mm: f64,
    /// Mean distance of the nominal model with the joint zeros and the base and tool that belong to them, in mm.
    pub joint_zeros_mm: f64,
    /// Mean distance of the Denavit-Hartenberg table, in mm.
    pub dh_mm: f64,
}

/// Signed errors of the held-out poses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BeforeAndAfter {
    /// Signed errors of the nominal model with base and tool fitted.
    pub before: SignedResiduals,
    /// Signed errors of the calibrated model.
    pub after: SignedResiduals,
}

/// The part `controller` of a JSON document.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControllerSummary {
    /// Rows of the distal Denavit-Hartenberg table, joint by joint.
    pub dh: Vec<DhChange>,
    /// Joint zeros; empty where the nominal model without them is as near to the model.
    pub joint_zeros: Vec<JointZero>,
    /// Distances from the whole model.
    pub distance: Distances,
    /// What live corrections leave.
    pub live: LiveCorrection,
    /// Signed errors; absent where no pose was held out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residuals: Option<BeforeAndAfter>,
}

impl ControllerSummary {
    /// Creates the summary of a blob of `robot`. `known` is the covariance of the model's predictions, with the whole poses
    /// to which its first entries belong; `held_out` are the held-out poses.
    pub fn new(
        blob: &BlobModel,
        robot: &Robot,
        known: Option<(&PredictionCovariance, &[InstrumentSample])>,
        held_out: Option<&ReportData>,
    ) -> Self {
        let predicted = PredictedPoses::new(blob, Region::trained(blob.blob()));
        let chain = CalibratedChain::nearest(blob, &predicted);
        let coupling = chain.coupling.as_deref();
        let zeros = JointOffsets::new(
            &predicted,
            &chain.nominal_arm(),
            &chain.flange_from_target,
            coupling,
        );
        let kinds = robot.kinds();
        let deviation = known
            .and_then(|(known, poses)| ChainDeviation::new(known, poses, &chain.poe(), coupling));
        let std = deviation.as_ref().map(|d| deviations(&chain, &d.frames));
        let (nominal, calibrated) = rows_beside_nominal(&chain);
        let row = |i: usize| {
            let std = std.as_ref().map(|rows| rows[i]);
            dh_change(&robot.joints[i], &nominal[i], &calibrated[i], std)
        };
        let zero = |i: usize| {
            let unit = match kinds[i] {
                JointKind::Revolute => 180.0 / std::f64::consts::PI,
                JointKind::Prismatic => 1e3,
            };
            let offset = Some(unit * zeros.offsets[i]);
            let turns = kinds[i] == JointKind::Revolute;
            let std = deviation.as_ref().map(|d| unit * d.zeros[i]);
            JointZero {
                joint: robot.joints[i].name.clone(),
                offset_deg: offset.filter(|_| turns),
                offset_mm: offset.filter(|_| !turns),
                std: std.filter(|std| *std > 0.0),
            }
        };
        let joints = 0..kinds.len();
        // `trainer export` also refuses joint zeros that are no nearer to the model than the nominal model.
        let nominal_mm = chain.distance.nominal.position_mm.mean;
        let is_nearer = zeros.error.position_mm.mean < nominal_mm;
        Self {
            dh: joints.clone().map(row).collect(),
            joint_zeros: joints.filter(|_| is_nearer).map(zero).collect(),
            distance: Distances {
                nominal_mm,
                joint_zeros_mm: zeros.error.position_mm.mean,
                dh_mm: chain.distance.chain.position_mm.mean,
            },
            live: LiveCorrection::new(blob),
            residuals: held_out.map(|data| {
                let rows = |poses: &'_ [HeldOutPose]| -> Vec<(Vec<f64>, HeldOutPose)> {
                    let rows = data.rows.iter().map(|row| row.joints.clone());
                    rows.zip(poses.iter().copied()).collect()
                };
                let (before, after) = (rows(&data.nominal().poses), rows(&data.calibrated().poses));
                let of = |rows: &[(Vec<f64>, HeldOutPose)]| {
                    let rows: Vec<Row> =
                        rows.iter().map(|(q, pose)| (q.as_slice(), pose)).collect();
                    SignedResiduals::new(robot, &chain.poe(), &rows, &weights(&rows))
                };
                BeforeAndAfter {
                    before: of(&before),
                    after: of(&after),
                }
            }),
        }
    }

    /// Returns the line about live corrections, if they are not complete.
    pub fn live_line(&self) -> Option<String> {
        let live = &self.live;
        (!live.is_complete()).then(|| {
            format!(
                "live corrections: over the trained ranges, the remaining error is at most {COMPLETE_MM} mm at {:.0} % \
                 of poses, {:.3} mm at 95 % and {:.3} mm at the worst; near singularities, a complete correction would move \
                 joints too fast",
                100.0 * live.complete,
                live.remaining_mm.p95,
                live.remaining_mm.max
            )
        })
    }

    /// Returns the summary as CSV, with a row for each number.
    pub fn to_csv(&self) -> String {
        let header = ["table", "name", "quantity", "unit", "before", "after"].into_iter();
        let header = header.chain(["difference", "std_before", "std_after"]);
        let mut file = csv::File::new(&[], header);
        let mut write = |names: [&str; 4], numbers: [Option<f64>; 5]| {
            let numbers = numbers.map(|x| x.map_or_else(String::new, |x| x.to_string()));
            file.row(names.map(str::to_owned).into_iter().chain(numbers));
        };
        for row in &self.dh {
            let beta = row.beta_deg.as_ref().map(|beta| ("beta", "deg", beta));
            let all = [
                ("a", "mm", &row.a_mm),
                ("d", "mm", &row.d_mm),
                ("alpha", "deg", &row.alpha_deg),
                ("theta", "deg", &row.theta_deg),
            ];
            for (name, unit, n) in all.into_iter().chain(beta) {
                let numbers = [
                    Some(n.nominal),
                    Some(n.calibrated),
                    Some(n.difference),
                    None,
                    n.std,
                ];
                write(["dh", &row.joint, name, unit], numbers);
            }
        }
        for zero in &self.joint_zeros {
            let unit = if zero.offset_deg.is_some() {
                "deg"
            } else {
                "mm"
            };
            let offset = zero.offset_deg.or(zero.offset_mm);
            let numbers = [Some(0.0), offset, offset, None, zero.std];
            write(["joint_zero", &zero.joint, "offset", unit], numbers);
        }
        let Some(BeforeAndAfter { before, after }) = &self.residuals else {
            return file.text;
        };
        let mut pair = |table: &str, name: &str, unit: &str, before: &Signed, after: &Signed| {
            let numbers = [
                before.mean,
                after.mean,
                after.mean - before.mean,
                before.std,
                after.std,
            ];
            write([table, name, "residual", unit], numbers.map(Some));
        };
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            pair(
                "axis",
                name,
                "mm",
                &before.axes_mm[axis],
                &after.axes_mm[axis],
            );
        }
        if let (Some(before), Some(after)) = (&before.axes_mrad, &after.axes_mrad) {
            for (axis, name) in ["about_x", "about_y", "about_z"].iter().enumerate() {
                pair("axis", name, "mrad", &before[axis], &after[axis]);
            }
        }
        let joints = self.dh.iter().zip(before.joints.iter().zip(&after.joints));
        for (row, (before, after)) in joints {
            pair("joint", &row.joint, row.residual_unit, before, after);
        }
        file.text
    }
}

fn dh_change(
    joint: &Joint,
    nominal: &DhRow,
    calibrated: &DhRow,
    std: Option<[f64; 5]>,
) -> DhChange {
    let (before, found) = (numbers(nominal), numbers(calibrated));
    let number = |i: usize| {
        let unit = if i < 2 {
            1e3
        } else {
            180.0 / std::f64::consts::PI
        };
        let difference = found[i] - before[i];
        let difference = if i < 2 {
            difference
        } else {
            wrapped(difference)
        };
        Changed {
            nominal: unit * before[i],
            calibrated: unit * found[i],
            difference: unit * difference,
            std: std.map(|std| unit * std[i]),
        }
    };
    DhChange {
        joint: joint.name.clone(),
        residual_unit: match joint.kind {
            JointKind::Revolute => "mrad",
            JointKind::Prismatic => "mm",
        },
        a_mm: number(0),
        d_mm: number(1),
        alpha_deg: number(2),
        theta_deg: number(3),
        beta_deg: calibrated.beta.map(|_| number(4)),
    }
}
