//! Finds mistakes that shift each row in proportion to what the rows hold: a coupling or a gear ratio that the description
//! does not have, axes or distances of the instrument with a wrong scale, orientations in another frame, joints that were read
//! before the arm stood still, and a filter over neighbouring rows.
//!
//! The geometry takes up a part of such a mistake and its residuals show the rest. Each mistake is a few terms that are added
//! to the geometry. The one that explains most of the residuals is named.

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::identification::parametric::state::ROWS;
use crate::measurement::JointUnit;
use crate::trust::added_terms::{AddedTerms, Optimum};
use crate::trust::change_points::needed;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::readings::Data;
use crate::trust::wording::{fits_equally, length, three_digits};

/// Shares of χ² that a mistake must explain to be warned of and to be refused: on measured arms none explains above 0.13.
const EXPLAINED: (f64, f64) = (0.25, 0.35);
/// Share of χ² above which a mistake explains what was refused without a reason.
const CERTAIN: f64 = 0.5;
/// Smallest coupling or ratio, smallest share of an axis, a move or a neighbour, smallest distance in m, and smallest turn in
/// rad: less is within what honest arms and instruments do.
const LEAST_RATIO: f64 = 1.5e-3;
const LEAST_SHARE: f64 = 4e-4;
const LEAST_DISTANCE: f64 = 2e-4;
const LEAST_TURN: f64 = 3e-3;
/// Smallest play of a joint in rad or m that is more than the backlash of a gear in order.
const LEAST_PLAY: f64 = 3.5e-4;
/// Difference of a coupling from the stated one below which bars of the linkage, not the description, may be the cause.
const OF_BARS: f64 = 0.01;
/// Share of the best mistake's drop of χ² above which another one fits as well.
const AS_GOOD: f64 = 0.97;
/// Most other mistakes that are listed.
const OTHERS: usize = 2;

/// A mistake in all rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mistake {
    /// The first joint of the serial chain also turns with the controller's second joint.
    Coupled(usize, usize),
    /// A joint turns or moves more, or less, than stated.
    Ratio(usize),
    /// An axis of the instrument has another scale.
    Axis(usize),
    /// Distances from the instrument have an offset.
    Distance,
    /// The orientations are of another frame than the positions.
    Turned,
    /// The joints were read before the arm had arrived.
    Early,
    /// Each position is averaged with those of its neighbours.
    Averaged,
    /// The joints stop short on the side that they come from: they have play, or were read before they stood still.
    Play,
}

impl Mistake {
    fn all(joints: usize) -> Vec<Self> {
        let joint = |a: usize| {
            let of = move |b: usize| match a == b {
                true => Self::Ratio(a),
                false => Self::Coupled(a, b),
            };
            (0..joints).map(of)
        };
        let mut out: Vec<Self> = (0..joints).flat_map(joint).collect();
        out.extend((0..3).map(Self::Axis));
        out.extend([
            Self::Distance,
            Self::Turned,
            Self::Early,
            Self::Averaged,
            Self::Play,
        ]);
        out
    }

    fn terms(self, joints: usize) -> usize {
        match self {
            Self::Turned => 3,
            Self::Play => joints,
            _ => 1,
        }
    }

    fn cause(self) -> Cause {
        match self {
            Self::Coupled(..) => Cause::Coupling,
            Self::Ratio(_) | Self::Axis(_) | Self::Distance => Cause::Unit,
            Self::Turned => Cause::Orientation,
            Self::Early | Self::Play => Cause::Lag,
            Self::Averaged => Cause::Rows,
        }
    }

    /// Returns whether a mistake with these coefficients is larger than what honest arms and instruments do.
    fn is_large(self, x: &[f64]) -> bool {
        let size = match self {
            Self::Play => x[most(x)].abs(),
            _ => x.iter().map(|x| x * x).sum::<f64>().sqrt(),
        };
        size > match self {
            Self::Coupled(..) | Self::Ratio(_) => LEAST_RATIO,
            Self::Axis(_) | Self::Early | Self::Averaged => LEAST_SHARE,
            Self::Distance => LEAST_DISTANCE,
            Self::Turned => LEAST_TURN,
            Self::Play => LEAST_PLAY,
        }
    }

    /// Describes the mistake with these coefficients; `units` are those of the joint columns, and `coupling` is the stated one.
    fn text(self, x: &[f64], units: &[JointUnit], coupling: Option<&[Vec<f64>]>) -> String {
        let percent = |x: f64| format!("{} %", three_digits(100.0 * x.abs()));
        let more = |more: &'static str, less: &'static str| match x[0] > 0.0 {
            true => more,
            false => less,
        };
        match self {
            Self::Coupled(a, b) => coupling_text((a, b), x[0], units, coupling),
            Self::Ratio(a) => format!(
                "joint {} {} {} {} than its column states: check its gear ratio and its unit",
                a + 1,
                if units[a].is_angle() {
                    "turns"
                } else {
                    "moves"
                },
                percent(x[0]),
                more("more", "less")
            ),
            Self::Axis(i) => format!(
                "lengths along {} of the instrument are {} too {}: check its scales",
                ["x", "y", "z"][i],
                percent(x[0]),
                more("long", "short")
            ),
            Self::Distance => format!(
                "distances from the instrument are {} too {}: check the reflector's radius or prism constant",
                length(x[0].abs()),
                more("long", "short")
            ),
            Self::Turned => format!(
                "the orientations are turned by {:.2}° relative to the positions: export both in one frame, or leave out \
                 the quaternion",
                Vector3::from_row_slice(x).norm().to_degrees()
            ),
            Self::Early => format!(
                "{} of the move from the row before was missing when the {} were read: wait until the arm stands still",
                percent(x[0]),
                more("joints", "poses")
            ),
            Self::Play => {
                let joint = most(x);
                let by = units[joint].from_si(2.0 * x[joint].abs());
                format!(
                    "joint {} ends {} {} apart, depending on the side that it comes from: it has play, or was read before the \
                     arm stood still; wait until it stands, and approach every pose from the same side",
                    joint + 1,
                    three_digits(by),
                    units[joint].symbol()
                )
            }
            Self::Averaged => format!(
                "each position holds {} of the one before and of the one after: export unfiltered positions",
                percent(x[0])
            ),
        }
    }
}

/// Says that the joint `a` of the chain also turns with the controller's joint `b`, by `x`.
fn coupling_text(
    (a, b): (usize, usize),
    x: f64,
    units: &[JointUnit],
    coupling: Option<&[Vec<f64>]>,
) -> String {
    let (row, column) = (a + 1, b + 1);
    if let Some(stated) = coupling.map(|rows| rows[a][b]) {
        return format!(
            "row {row} of the stated coupling looks like {:.4} for q{column} instead of {stated}: correct it in the robot's \
             description",
            stated + x
        );
    }
    let (own, other) = (units[a], units[b]);
    let factor = own.from_si(x.abs()) / other.from_si(1.0);
    let unit = match own == other {
        true => String::new(),
        false => format!(" {}/{} ·", own.symbol(), other.symbol()),
    };
    let in_si = match (own.is_angle(), other.is_angle()) {
        (true, false) => ", in rad/m",
        (false, true) => ", in m/rad",
        _ => "",
    };
    format!(
        "joint {row} looks coupled: q{row} {} {factor:.4}{unit} q{column} instead of q{row}: export decoupled joints, or state \
         the coupling in the robot's description ({x:.5} for q{column} in row {row}{in_si})",
        if x > 0.0 { "+" } else { "−" },
    )
}

/// Returns the index of the largest coefficient.
fn most(x: &[f64]) -> usize {
    let larger = |a: &usize, b: &usize| x[*a].abs().total_cmp(&x[*b].abs());
    (0..x.len()).max_by(larger).unwrap_or(0)
}

/// Computes the effects of mistakes on the residuals.
struct Effects<'a> {
    geometry: &'a Geometry,
    /// For each sample, the displacement in m by 1 of each mistake that displaces positions, in the base frame.
    axes: Vec<[Vector3<f64>; 3]>,
    away: Vec<Vector3<f64>>,
    averaged: Vec<Vector3<f64>>,
    /// For each sample, the effects of the chain's joints on its residual components, where the controller's are coupled.
    serial: Option<Vec<Vec<[f64; ROWS]>>>,
}

impl<'a> Effects<'a> {
    fn new(data: &Data<'_>, base: &Pose<f64>, geometry: &'a Geometry) -> Self {
        let seen = |k: usize| data.samples[k].observation.position();
        let at = |k: usize| geometry.samples[k].observation.position();
        let count = geometry.samples.len();
        // From the axes of the instrument to those of the base.
        let turn = base.rotation.transpose();
        let axes = |k: usize| {
            let p = seen(k);
            std::array::from_fn(|i| turn.column(i) * p[i])
        };
        let averaged = |k: usize| match k > 0 && k + 1 < count {
            true => at(k - 1) + at(k + 1) - 2.0 * at(k),
            false => Vector3::zeros(),
        };
        let serial = || (0..count).map(|k| serial_effects(geometry, k)).collect();
        Self {
            geometry,
            serial: data.robot.coupling.is_some().then(serial),
            axes: (0..count).map(axes).collect(),
            away: (0..count).map(|k| turn * seen(k).normalize()).collect(),
            averaged: (0..count).map(averaged).collect(),
        }
    }

    /// Returns the effect of a term on a residual component of sample `k`.
    fn of(&self, mistake: Mistake, term: usize, k: usize, row: usize) -> f64 {
        let g = self.geometry;
        let sample = &g.samples[k];
        let scales = g.scales.of(sample);
        let component = row % ROWS;
        let displaced = |by: &Vector3<f64>| match component < 3 {
            true => by[component] / scales.position,
            false => 0.0,
        };
        let joint = |j: usize| g.linear.jacobian[(row, j)];
        match mistake {
            Mistake::Coupled(a, b) => {
                let of_chain = |all: &Vec<Vec<[f64; ROWS]>>| all[k][a][component];
                self.serial.as_ref().map_or_else(|| joint(a), of_chain) * sample.joints[b]
            }
            Mistake::Ratio(a) => joint(a) * sample.joints[a],
            Mistake::Axis(i) => displaced(&self.axes[k][i]),
            Mistake::Distance => displaced(&self.away[k]),
            Mistake::Averaged => displaced(&self.averaged[k]),
            Mistake::Turned if component == 3 + term && sample.observation.has_orientation() => {
                1.0 / scales.orientation
            }
            Mistake::Turned => 0.0,
            Mistake::Early | Mistake::Play if k == 0 => 0.0,
            Mistake::Play => {
                joint(term) * (sample.joints[term] - g.samples[k - 1].joints[term]).signum()
            }
            Mistake::Early => {
                let moved = sample.joints.iter().zip(&g.samples[k - 1].joints);
                let parts = moved
                    .enumerate()
                    .map(|(j, (q, before))| joint(j) * (q - before));
                parts.sum()
            }
        }
    }
}

/// Returns the effects of the chain's joints on the residual components of sample `k`.
fn serial_effects(geometry: &Geometry, k: usize) -> Vec<[f64; ROWS]> {
    let sample = &geometry.samples[k];
    let chain = geometry.state.chain(sample.tool);
    let (columns, pose) = chain.space_jacobian(&sample.serial_joints);
    let scales = geometry.scales.of(sample);
    let equations = sample.observation.equations();
    let of = |column: &Twist<f64>| {
        let parts = column.at_point(&pose.translation).to_array();
        std::array::from_fn(|i| match i {
            i if i >= equations => 0.0,
            0..3 => parts[i] / scales.position,
            _ => parts[i] / scales.orientation,
        })
    };
    let joints = geometry.state.layout.joints;
    columns[..joints].iter().map(of).collect()
}

/// A mistake, its coefficients, and the drop of χ² that it causes.
struct Explanation {
    mistake: Mistake,
    optimum: Optimum,
    drop: f64,
}

impl Explanation {
    fn text(&self, data: &Data<'_>) -> String {
        let coupling = data.robot.coupling.as_deref();
        self.mistake
            .text(&self.optimum.coefficients, &data.units, coupling)
    }

    /// Returns whether a stated coupling is off by no more than bars explain that are not quite to size.
    fn is_small_coupling(&self, data: &Data<'_>) -> bool {
        let is_coupled = matches!(self.mistake, Mistake::Coupled(..));
        is_coupled && data.robot.coupling.is_some() && self.optimum.coefficients[0].abs() < OF_BARS
    }
}

/// Returns all mistakes, first the one that explains most.
fn best_first(data: &Data<'_>, base: &Pose<f64>, geometry: &Geometry) -> Vec<Explanation> {
    let effects = Effects::new(data, base, geometry);
    let joints = geometry.state.layout.joints;
    let mistakes = Mistake::all(joints);
    let terms: Vec<(Mistake, usize)> = (mistakes.iter())
        .flat_map(|m| (0..m.terms(joints)).map(move |term| (*m, term)))
        .collect();
    let rows = 0..geometry.samples.len();
    let sums = AddedTerms::over(geometry, terms.len(), rows, |k, row, column| {
        let (mistake, term) = terms[column];
        effects.of(mistake, term, k, row)
    });
    let of = |mistake: Mistake| {
        let columns = (0..terms.len()).filter(|c| terms[*c].0 == mistake);
        let optimum = sums.of(&columns.collect::<Vec<_>>()).optimum(geometry)?;
        Some(Explanation {
            mistake,
            drop: optimum.drops.iter().sum(),
            optimum,
        })
    };
    let mut found: Vec<Explanation> = mistakes.into_iter().filter_map(of).collect();
    found.sort_by(|a, b| b.drop.total_cmp(&a.drop));
    found
}

/// Returns a warning or a refusal if one mistake explains most of the residuals; `base` is `instrument_from_base`.
pub fn examine(data: &Data<'_>, base: &Pose<f64>, geometry: &Geometry) -> Option<Finding> {
    explaining(data, base, geometry, EXPLAINED.0)
}

/// Returns the refusal for a mistake that explains nearly all residuals of rows that were refused without a reason.
pub fn certain(data: &Data<'_>, base: &Pose<f64>, geometry: &Geometry) -> Option<Finding> {
    explaining(data, base, geometry, CERTAIN).filter(|f| f.tier == Tier::Refused)
}

fn explaining(
    data: &Data<'_>,
    base: &Pose<f64>,
    geometry: &Geometry,
    least: f64,
) -> Option<Finding> {
    let found = best_first(data, base, geometry);
    let (best, others) = found.split_first()?;
    let share = best.drop / geometry.chi_squared(0..geometry.samples.len());
    let (drop, needed) = (
        best.drop / geometry.noise_factor().powi(2),
        needed(geometry),
    );
    let is_large = best.mistake.is_large(&best.optimum.coefficients);
    if share < least || drop < needed || !is_large {
        return None;
    }
    let mut text = best.text(data);
    let others: Vec<String> = (others.iter())
        .take_while(|other| other.drop > AS_GOOD * best.drop)
        .take(OTHERS)
        .map(|other| other.text(data))
        .collect();
    text += &fits_equally(&others);
    // An arm with play can be calibrated; it cannot be better than its play. What bars of a linkage add is learnt.
    let is_usable = best.mistake == Mistake::Play || best.is_small_coupling(data);
    let tier = Tier::refused_if(share > EXPLAINED.1 && !is_usable);
    let rows = geometry.samples.len() as f64;
    let cause = best.mistake.cause();
    Some(Finding::new(cause, tier, text, drop / rows, needed / rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A user compares the factor with the columns of the file, whatever their units are.
    #[test]
    fn a_coupling_is_in_the_units_of_the_columns() {
        use JointUnit::{Degree, Metre, Millimetre, Radian};
        let said = |a, b| Mistake::Coupled(0, 1).text(&[-0.0114], &[a, b], None);
        let stated = |a, b| {
            let text = said(a, b);
            let (_, rest) = text.split_once("q1 − ").unwrap();
            rest.split_once(" q2").unwrap().0.to_owned()
        };
        assert_eq!(stated(Millimetre, Degree), "0.1990 mm/deg ·");
        assert_eq!(stated(Millimetre, Radian), "11.4000 mm/rad ·");
        assert_eq!(stated(Metre, Radian), "0.0114 m/rad ·");
        assert_eq!(stated(Degree, Millimetre), "0.0007 deg/mm ·");
        for same in [Degree, Radian, Millimetre] {
            assert_eq!(stated(same, same), "0.0114");
        }
    }

    #[test]
    fn a_slide_moves_and_a_revolute_joint_turns() {
        let said = |unit, by| Mistake::Ratio(0).text(&[by], &[unit], None);
        let turns = "joint 1 turns 0.93 % less than its column states";
        assert!(said(JointUnit::Degree, -0.0093).starts_with(turns));
        let moves = "joint 1 moves 0.93 % more than its column states";
        assert!(said(JointUnit::Metre, 0.0093).starts_with(moves));
    }
}
