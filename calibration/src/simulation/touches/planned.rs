//! Simulates the touches of a plan.

use nalgebra::{Matrix3, Vector3};

use super::sensors::Wire;
use super::{
    OutOfReach, SimulatedTouches, TIP, TIP_ERROR, TOUCH_NOISE, Touching, description_of_tip,
};
use crate::measurement::touch::{Feature, FeatureKind, TouchRow, TouchSet};
use crate::numeric::rotation::centroid;
use crate::robot::Robot;
use crate::robot::settle::Surface;
use crate::simulation::Simulator;
use crate::simulation::true_arm::normal_vector;

/// Where a feature of a plan truly is.
#[derive(Clone, Copy)]
enum Placed {
    Point(Vector3<f64>),
    /// Unit normal, and distance of the plane from the origin along it.
    Plane(Vector3<f64>, f64),
    Wire(Wire),
}

impl Simulator {
    /// Touches the sockets and planes of a plan, like an operator who moves the tip there: from the joints of each row to the
    /// nearest joints at which the true tip is seated. Reads its draw-wires at the planned joints. The first row of a socket
    /// determines its position, all rows of a plane determine the plane. The distances from the first socket are measured.
    /// `truth` is as in [`Simulator::touch`].
    ///
    /// # Errors
    /// Returns [`OutOfReach`] if the feature of a row cannot be reached, or if it is none of these or an anchor anywhere.
    pub fn touch_planned(
        &mut self,
        robot: &Robot,
        plan: &TouchSet,
        truth: usize,
        comment: &str,
    ) -> Result<(SimulatedTouches, String), OutOfReach> {
        let nominal = plan
            .tips
            .first()
            .map_or(Vector3::from(TIP), |tip| tip.position);
        let error = normal_vector(TIP_ERROR, &mut self.random);
        let mut touching = Touching {
            robot,
            payload_kg: self.payloads.first().copied().unwrap_or(0.0),
            ranges: whole_ranges(robot),
            simulator: self,
            tip: nominal + error,
            rows: Vec::new(),
            toml: description_of_tip(comment, nominal),
        };
        let mut features: Vec<Option<Placed>> = vec![None; plan.features.len()];
        for row in &plan.rows {
            let feature = row.reading.feature();
            let unknown = || OutOfReach("a row without a feature".to_owned());
            let feature = feature.ok_or_else(unknown)?;
            let name = &plan.features[feature].name;
            let out_of_reach = || OutOfReach(name.clone());
            let placed = match features[feature] {
                Some(placed) => placed,
                None => touching
                    .located(plan, feature, row)
                    .ok_or_else(out_of_reach)?,
            };
            features[feature] = Some(placed);
            let surface = match placed {
                Placed::Point(at) => {
                    Surface::Point(at + normal_vector(TOUCH_NOISE, touching.random()))
                }
                Placed::Plane(normal, distance) => {
                    Surface::Plane(normal, distance + TOUCH_NOISE * touching.normal())
                }
                Placed::Wire(wire) => {
                    touching.read_wire(name, &wire, &row.joints);
                    continue;
                }
            };
            let joints = touching
                .seated(&row.joints, touching.tip, surface)
                .ok_or_else(out_of_reach)?;
            touching.row(name, ",,,,,,", &joints);
        }
        let names = plan.features.iter().map(|feature| feature.name.clone());
        let points = names.zip(&features).filter_map(|(name, placed)| {
            let Some(Placed::Point(at)) = placed else {
                return None;
            };
            Some((name, *at))
        });
        let points: Vec<(String, Vector3<f64>)> = points.collect();
        touching.describe_sockets(&points);
        touching.ranges = touching.simulator.ranges.clone();
        Ok(touching.finished(truth, comment))
    }
}

impl Touching<'_> {
    /// Puts a feature of a plan where the tip truly is at the planned joints, and describes it unless it is a socket. `row` is
    /// its first row. Returns `None` for a kind that is not simulated from a plan.
    fn located(&mut self, plan: &TouchSet, feature: usize, row: &TouchRow) -> Option<Placed> {
        let Feature { name, kind, .. } = &plan.features[feature];
        match *kind {
            FeatureKind::Point { .. } => Some(Placed::Point(self.tip_at(&row.joints))),
            FeatureKind::Plane { .. } => {
                let rows = plan.rows.iter();
                let rows = rows.filter(|row| row.reading.feature() == Some(feature));
                let tips: Vec<Vector3<f64>> = rows.map(|row| self.tip_at(&row.joints)).collect();
                let middle = centroid(&tips);
                let spread: Matrix3<f64> = tips
                    .iter()
                    .map(|tip| (tip - middle) * (tip - middle).transpose())
                    .sum();
                let spread = spread.symmetric_eigen();
                let normal = spread.eigenvectors.column(spread.eigenvalues.imin());
                self.describe_plane(name);
                Some(Placed::Plane(normal.into_owned(), normal.dot(&middle)))
            }
            FeatureKind::Anchor {
                position: Some(stated),
                position_sigma,
                zero_sigma,
                ..
            } => {
                let at = stated + normal_vector(position_sigma, self.random());
                let zero = zero_sigma * self.normal();
                self.describe_wire(name, stated, [position_sigma, zero_sigma]);
                Some(Placed::Wire(Wire { at, zero }))
            }
            _ => None,
        }
    }
}

/// Returns the full range of each joint, in rad or m.
fn whole_ranges(robot: &Robot) -> Vec<(f64, f64)> {
    let whole = (-std::f64::consts::TAU, std::f64::consts::TAU);
    let limits = robot.joints.iter().map(|joint| joint.limits);
    limits.map(|limits| limits.unwrap_or(whole)).collect()
}
