//! Examines the residuals of the geometry: rows that do not belong, a scatter that neither the digits nor the stated
//! uncertainty explain, links that differ from the nominal model.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;

use crate::identification::parametric::state::ROWS;
use crate::measurement::MeasurementSet;
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::shared_range::{SharedRange, shared_payload};
use crate::numeric::statistics::{ErrorSummary, extremes};
use crate::trust::change_points::{Part, changes};
use crate::trust::digits::{positions_mm, step};
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::mixture;
use crate::trust::payloads;
use crate::trust::ratio;
use crate::trust::readings::Data;
use crate::trust::unsettled;
use crate::trust::wording::{length, lengths, lines, three_digits};

/// Residual of a row per equation, in standard deviations, above which the row does not belong.
const OUTLIER: f64 = 7.0;
/// Share of rows that do not belong above which the file is refused.
const MANY: f64 = 0.25;
/// Ratio of the median residual to the reach above which the geometry does not explain the data.
const LEFT: f64 = 0.0035;
/// Ratio of the nominal arm's median residual to the geometry's below which the poses are the nominal ones.
const NOMINAL: f64 = 1.12;
/// Residual of the nominal arm above which the poses were not computed by a controller, in m.
const COMPUTED: f64 = 0.12e-3;
/// Largest error in mm of positions that no instrument measured, and the number of poses of which this is certain.
const UNMEASURED_MM: f64 = 1e-3;
const FEW: usize = 5;
/// Deviation of a frame from the nominal model above which a warning is given, in m and rad.
const FRAME: (f64, f64) = (6.5e-3, 35e-3);
/// Ratio of the scatter to the stated standard deviation above which the latter is understated, and the smallest scatter in
/// m that counts.
const UNDERSTATED: (f64, f64) = (6.0, 0.22e-3);
/// Ratio of the scatter to the stated standard deviation that no arm explains.
const OTHER_UNIT: f64 = 60.0;
/// Ratio of the stated standard deviation to the scatter above which the former is overstated.
const OVERSTATED: f64 = 8.0;
/// Share of the scatter caused by rounding the positions above which the rounding is reported.
const ROUNDED: f64 = 0.3;
/// Share of the scatter that rounding the joints would cause above which it is reported.
const ROUNDED_JOINTS: f64 = 0.4;
/// Range of a joint in steps of its digits below which rounding is no scatter.
const STEPS: f64 = 10.0;
/// Share of the covariance that rounded joints cause above which the residuals show it: 1 if the joints were rounded after
/// the arm had moved, 0 if they were commanded with these digits.
const SHOWN: f64 = 0.5;

/// Returns the findings from the residuals. `nominal` is the median position residual of the nominal arm, in m.
pub fn examine(
    data: &Data<'_>,
    set: &MeasurementSet,
    geometry: &Geometry,
    nominal: f64,
    reach: f64,
) -> Vec<Finding> {
    let scene = Scene {
        data,
        set,
        geometry,
    };
    let mut out = Vec::new();
    let left = scene.left(reach);
    match scene.rounding() {
        // Missing digits explain the residuals and a scatter above the stated uncertainty.
        Some(rounding) => out.push(Finding {
            tier: left.map_or(Tier::Warning, |left| left.tier),
            ..rounding
        }),
        None => {
            out.extend(left);
            out.extend(scene.noise());
        }
    }
    out.extend(scene.outliers());
    out.extend(payloads::examine(geometry));
    out.extend(mixture::examine(data, geometry));
    out.extend(ratio::examine(geometry).or_else(|| scene.frames()));
    if out.is_empty() {
        out.extend(scene.nominal(nominal));
    }
    out
}

struct Scene<'a> {
    data: &'a Data<'a>,
    set: &'a MeasurementSet,
    geometry: &'a Geometry,
}

fn warning(cause: Cause, text: String, value: f64, threshold: f64) -> Finding {
    Finding::new(cause, Tier::Warning, text, value, threshold)
}

/// Returns the finding that positions scatter by more than the stated standard uncertainty explains, both in m.
fn understated_noise(stated: f64, scatter: f64) -> Option<Finding> {
    let ratio = scatter / stated;
    (ratio > UNDERSTATED.0 && (scatter > UNDERSTATED.1 || ratio > OTHER_UNIT)).then(|| {
        let verdict = "is sigma in another unit, or is the instrument worse than stated?";
        noise(stated, scatter, verdict, ratio, UNDERSTATED.0)
    })
}

/// Returns the finding that positions scatter by less than the stated standard uncertainty, both in m.
pub fn overstated_noise(stated: f64, scatter: f64) -> Option<Finding> {
    let ratio = stated / scatter;
    let verdict = "is sigma in another unit?";
    (ratio > OVERSTATED).then(|| noise(stated, scatter, verdict, ratio, OVERSTATED))
}

/// Returns the refusal that a model is judged by its own predictions: no arm repeats so well, and no instrument measures so.
pub fn computed_by_model(errors: &ErrorSummary) -> Option<Finding> {
    let largest = errors.position_mm.max;
    (errors.poses >= FEW && largest < UNMEASURED_MM).then(|| {
        let text = format!(
            "the model predicts all {} positions to {}: these poses were computed by it, not measured",
            errors.poses,
            length(1e-3 * largest)
        );
        Finding::new(Cause::Readout, Tier::Refused, text, largest, UNMEASURED_MM)
    })
}

fn noise(stated: f64, scatter: f64, verdict: &str, value: f64, threshold: f64) -> Finding {
    let text = format!(
        "a standard uncertainty of {} is stated, but the positions scatter by {}: {verdict}",
        length(stated),
        length(scatter)
    );
    warning(Cause::Noise, text, value, threshold)
}

impl Scene<'_> {
    fn has_orientation(&self) -> bool {
        self.geometry
            .samples
            .iter()
            .any(|s| s.observation.has_orientation())
    }

    fn left(&self, reach: f64) -> Option<Finding> {
        let share = self.geometry.position / reach;
        (share > LEFT).then(|| {
            let text = format!(
                "the fitted geometry leaves {}, and nothing that was tried explains it: check that this is the robot, \
                 and that the joints and the pose of each row belong together",
                lengths(self.geometry.position, self.geometry.rotation, self.has_orientation())
            );
            Finding::new(Cause::NoFit, Tier::Refused, text, share, LEFT)
        })
    }

    fn outliers(&self) -> Option<Finding> {
        let g = self.geometry;
        let count = g.samples.len();
        let least = OUTLIER * g.leniency();
        let off: Vec<usize> = (0..count).filter(|k| g.size(*k) > least).collect();
        let worst = (0..count).map(|k| g.size(k)).fold(0.0, f64::max);
        if off.is_empty() {
            return None;
        }
        let rows: Vec<usize> = off.iter().map(|k| self.data.line(*k)).collect();
        let mut text = format!(
            "{} of {count} rows are outliers ({}): up to {} standard deviations from the others",
            off.len(),
            lines(&rows),
            three_digits(worst)
        );
        let size: f64 = off
            .iter()
            .map(|k| g.weights[*k] * g.residuals[*k].iter().map(|r| r * r).sum::<f64>())
            .sum();
        if off.len() >= 3
            && let Some(change) = changes(g, &off)
                .into_iter()
                .find(|c| c.part != Part::Base || off.len() >= 6)
            && change.drop > 0.8 * size
        {
            let axes = match change.part {
                Part::Base => "the instrument's axes: it was moved in between".to_owned(),
                Part::Tool => "the target's axes: another target or reflector".to_owned(),
                Part::Joint(j) => format!("joint {}", j + 1),
                Part::Joints => "the joints".to_owned(),
            };
            text += &format!("; they share one shift in {axes}");
        }
        let joints: Vec<&[f64]> = g.samples.iter().map(|s| s.joints.as_slice()).collect();
        if let Some(range) = SharedRange::find(&joints, &off) {
            text += &self.in_range(&range, off.len());
        }
        let payloads: Vec<Option<f64>> = g.samples.iter().map(|s| s.payload_kg).collect();
        if let Some(payload) = shared_payload(&payloads, &off) {
            text += &format!(
                "; nearly all of them carry {payload} kg: measure more rows with it, and check payload_kg"
            );
        }
        let along_moves = self.along_moves(&off);
        let cause = match along_moves.is_some() {
            true => Cause::Lag,
            false => Cause::Outlier,
        };
        text.extend(along_moves.map(|what| format!("; {what}")));
        let share = off.len() as f64 / count as f64;
        let tier = Tier::refused_if(share > MANY);
        Some(Finding::new(cause, tier, text, worst, least).of_rows(rows))
    }

    /// Says that the rows `off` were read before the robot stood still.
    fn along_moves(&self, off: &[usize]) -> Option<String> {
        let g = self.geometry;
        let predicted =
            |tool: usize, joints: &[f64]| g.state.chain(tool).forward(joints).translation;
        let error = |k: usize| {
            let [x, y, z, ..] = g.residuals[k];
            g.scales.position * Vector3::new(x, y, z)
        };
        unsettled::describe(self.data, off, predicted, error)
    }

    /// Says that `range` has this share of the outliers, and what that means.
    fn in_range(&self, range: &SharedRange, outliers: usize) -> String {
        let joint = range.joint;
        let (scale, unit) = match self.data.robot.joints[joint].kind {
            JointKind::Revolute => (1_f64.to_degrees(), "°"),
            JointKind::Prismatic => (1e3, " mm"),
        };
        let of_them = match range.within == outliers {
            true => "all of them".to_owned(),
            false => format!("{} of them", range.within),
        };
        format!(
            "; {of_them} have joint {} between {:.1}{unit} and {:.1}{unit}: if rows measured there are off again, the \
             joint is damaged in this range, and the model does not hold there",
            joint + 1,
            scale * range.limits.0,
            scale * range.limits.1
        )
    }

    /// Returns the standard deviation of one position component, in m.
    fn scatter(&self) -> f64 {
        self.geometry.scales.position * self.geometry.noise_factor()
    }

    fn noise(&self) -> Option<Finding> {
        let stated = InstrumentNoise::rms_over(&self.geometry.samples).position?;
        let scatter = self.scatter();
        understated_noise(stated, scatter)
            .filter(|_| self.geometry.is_whole())
            .or_else(|| overstated_noise(stated, scatter))
    }

    fn rounding(&self) -> Option<Finding> {
        let g = self.geometry;
        let uniform = 12.0_f64.sqrt();
        let scatter = self.scatter();
        let position = 1e-3 * step(positions_mm(self.set)) / uniform;
        if position > ROUNDED * scatter {
            let text = format!(
                "the positions are rounded to {}, which alone causes {} of the {} of scatter: export more digits",
                length(position * uniform),
                length(position),
                length(scatter)
            );
            return Some(warning(Cause::Rounding, text, position / scatter, ROUNDED));
        }
        let mut square = 0.0;
        let mut widest = (0.0_f64, String::new());
        let mut variances = Vec::new();
        for (j, column) in self.set.joint_columns.iter().enumerate() {
            let values = self
                .set
                .measurements
                .iter()
                .map(|m| column.unit.from_si(m.joints[j]));
            let (low, high) = extremes(values.clone());
            // The rounding of a joint that hardly moves is an offset, which the geometry takes.
            let written = Some(step(values)).filter(|step| high - low > STEPS * step);
            let written = written.unwrap_or(0.0);
            let step = written / column.unit.from_si(1.0);
            let effect: f64 = (0..g.samples.len())
                .flat_map(|k| (0..3).map(move |b| (k, b)))
                .map(|(k, b)| g.linear.jacobian[(ROWS * k + b, j)].powi(2))
                .sum();
            let effect = (effect / (3 * g.samples.len()) as f64).sqrt() * g.scales.position;
            square += (effect * step / uniform).powi(2);
            variances.push((step / uniform).powi(2));
            if written > widest.0 {
                widest = (written, column.name.clone());
            }
        }
        let ratio = square.sqrt() / scatter;
        (ratio > ROUNDED_JOINTS && self.share_of(&variances) > SHOWN).then(|| {
            let text = format!(
                "the joints are rounded ({} to {}), which alone causes {} of the {} of scatter of the positions: \
                 export more digits",
                widest.1,
                three_digits(widest.0),
                length(square.sqrt()),
                length(scatter)
            );
            warning(Cause::Rounding, text, ratio, ROUNDED_JOINTS)
        })
    }

    /// Returns how much of the covariance that errors of the joints with these variances cause is in the residuals, beside
    /// noise of positions and of rotations: λ by least squares in r rᵀ ≈ v₁ I₁ + v₂ I₂ + λ C.
    fn share_of(&self, variances: &[f64]) -> f64 {
        let g = self.geometry;
        let (mut explained, mut possible) = (0.0, 0.0);
        let (mut count, mut noise, mut trace) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        for (k, residual) in g.residuals.iter().enumerate() {
            if g.weights[k] < 1.0 {
                continue;
            }
            let of = |i: usize, j: usize| -> f64 {
                let joints = variances.iter().enumerate();
                let both = |(c, v): (usize, &f64)| {
                    v * g.linear.jacobian[(ROWS * k + i, c)] * g.linear.jacobian[(ROWS * k + j, c)]
                };
                joints.map(both).sum()
            };
            let equations = g.samples[k].observation.equations();
            for i in 0..equations {
                let part = i / 3;
                count[part] += 1.0;
                noise[part] += residual[i] * residual[i];
                trace[part] += of(i, i);
                for j in 0..equations {
                    explained += of(i, j) * residual[i] * residual[j];
                    possible += of(i, j).powi(2);
                }
            }
        }
        for part in (0..2).filter(|part| count[*part] > 0.0) {
            explained -= trace[part] * noise[part] / count[part];
            possible -= trace[part] * trace[part] / count[part];
        }
        g.noise_factor().powi(2) * explained / possible.max(f64::MIN_POSITIVE)
    }

    fn frames(&self) -> Option<Finding> {
        let off = self.geometry.frames_off.iter().enumerate().skip(1);
        let (frame, (shift, turn)) = off.max_by(|a, b| {
            let far = |x: &(f64, f64)| (x.0 / FRAME.0).max(x.1 / FRAME.1);
            far(a.1).total_cmp(&far(b.1))
        })?;
        let ratio = (shift / FRAME.0).max(turn / FRAME.1);
        (ratio > 1.0).then(|| {
            let text = format!(
                "joint {} is {} and {:.2}° from its nominal position relative to joint {frame}: is this the right \
                 variant of the robot, and is it mastered?",
                frame + 1,
                length(*shift),
                turn.to_degrees()
            );
            warning(Cause::Frames, text, ratio, 1.0)
        })
    }

    fn nominal(&self, nominal: f64) -> Option<Finding> {
        let left = self.geometry.position * self.geometry.noise_factor();
        let ratio = nominal / left.max(1e-9);
        (ratio < NOMINAL && nominal < COMPUTED).then(|| {
            let text = format!(
                "the nominal robot leaves {}, and no fitted geometry leaves less than {}: is the description calibrated \
                 already, or did the controller compute these poses?",
                length(nominal),
                length(left)
            );
            warning(Cause::Readout, text, ratio, NOMINAL)
        })
    }
}
