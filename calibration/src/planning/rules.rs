//! The rules that can forbid a configuration.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::planning::links::{BASE_LINKS, Links, Stance};
use crate::planning::segment::Zone;

/// Requires that the instrument sees the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOfSight {
    /// Position of the instrument in the base frame, metres.
    pub instrument: Vector3<f64>,
    /// Axis of the target's frame that must face the instrument, a unit vector.
    pub normal: Vector3<f64>,
    /// Largest angle between that axis and the direction to the instrument, rad.
    pub max_angle: f64,
}

impl LineOfSight {
    fn sees(&self, base_from_target: &Pose<f64>) -> bool {
        let normal = base_from_target.rotation * self.normal;
        let to_instrument = self.instrument - base_from_target.translation;
        // At zero distance between instrument and target there is no direction, and the instrument sees nothing.
        normal.dot(&to_instrument) > libm::cos(self.max_angle) * to_instrument.norm()
    }
}

/// A rule that can forbid a configuration.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// Moving links stay above this z of the base frame, metres.
    Floor(f64),
    /// Links stay out of the base.
    Base,
    /// Moving links stay out of each other.
    Links,
    /// The target stays inside this box.
    Workspace(Zone),
    /// Moving links, with their radius, and the first two joints stay outside this box; the name is the user's.
    KeepOut(String, Zone),
    /// The instrument must see the target.
    LineOfSight(LineOfSight),
}

/// A rule, with the line of the file that states it.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// The rule.
    pub rule: Rule,
    /// Line in the file, from 1; absent if the file does not have the rule.
    pub line: Option<usize>,
}

impl Constraint {
    /// Returns the name of the rule in messages.
    pub fn name(&self) -> String {
        match &self.rule {
            Rule::Floor(_) => "floor".to_owned(),
            Rule::Base => "base".to_owned(),
            Rule::Links => "links".to_owned(),
            Rule::Workspace(_) => "workspace".to_owned(),
            Rule::KeepOut(name, _) => format!("keep_out \"{name}\""),
            Rule::LineOfSight(_) => "line_of_sight".to_owned(),
        }
    }

    /// Returns how the author of the rule can make it forbid less, as part of a sentence.
    pub fn remedy(&self) -> &'static str {
        match &self.rule {
            Rule::Floor(_) => {
                "write floor_mm, the z of what is below the arm, or floor = false into the constraints"
            }
            Rule::Base | Rule::Links => {
                "write the link_radius_mm of thinner links into the constraints or the robot description"
            }
            Rule::Workspace(_) => "enlarge the box of workspace",
            Rule::KeepOut(..) => "shrink the box of keep_out",
            Rule::LineOfSight(_) => "raise max_angle_deg, or move the instrument",
        }
    }

    /// Returns whether the rule allows an arm in this stance.
    pub fn allows(&self, links: &Links, stance: &Stance) -> bool {
        let target = &stance.base_from_target;
        match &self.rule {
            Rule::Floor(height) => links.lowest(stance) >= *height,
            Rule::Base => !links.collide(stance, true),
            Rule::Links => !links.collide(stance, false),
            Rule::Workspace(zone) => zone.contains(&target.translation),
            Rule::KeepOut(_, zone) => {
                let moving = stance.links.iter().zip(links.radii()).skip(BASE_LINKS);
                let mut first = stance.joints.iter().take(BASE_LINKS);
                !first.any(|joint| zone.contains(joint))
                    && moving
                        .map(|(link, r)| (link.distance_to_box(zone), *r))
                        .all(
                            // Links without thickness stay out, too.
                            |(distance, radius)| distance > 0.0 && distance >= radius,
                        )
            }
            Rule::LineOfSight(sight) => sight.sees(target),
        }
    }
}
