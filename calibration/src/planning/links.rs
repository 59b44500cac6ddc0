//! The links of an arm as capsules: straight segments between the origins of neighbouring joints, with a radius.
//!
//! Link 0 leads from the base frame to joint 1, link i from joint i to joint i + 1, link n from joint n to the flange, and
//! link n + 1 from the flange to the target. The travel of a slide is not a link, because what carries it is not known.
//! Links 0 and 1 count as the base, because they stay in the column that joint 1 turns in; the other links move.
//!
//! **Which parts are compared.** Neighbouring links touch at the joint between them and are left out, and so are links that
//! are separated only by joints at the same point. Other links can be nearer to each other than they are thick because the
//! links between them are short, as around a wrist or at an elbow. Parts of these are compared only if at least four radii
//! of arm lie between them. Pairs that still touch in every random configuration are due to how the description draws the
//! arm, and are left out, too.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::planning::segment::Segment;
use crate::robot::Robot;

/// Radius of a link if none is stated, as a share of the reach.
pub const RADIUS_SHARE: f64 = 0.08;
/// Length of arm, in radii, within which two parts count as connected and are not compared.
const NEIGHBOURHOOD: f64 = 4.0;
/// Number of links that count as the base.
pub const BASE_LINKS: usize = 2;
/// Number of configurations in which links that always touch are looked for.
const STRUCTURE_SAMPLES: usize = 256;
/// Length below which a link or a part of one counts as a point, metres.
const SHORTEST: f64 = 1e-6;
/// Cosine between the first axis and z of the base frame above which the robot stands on the xy plane.
const UPRIGHT: f64 = 0.99;

/// Source of the link radius.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RadiusSource {
    /// The constraints.
    Constraints,
    /// The robot description.
    Description,
    /// [`RADIUS_SHARE`] of the reach.
    Reach,
}

/// Two links whose parts are compared, by their indices; `first` is nearer to the base.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    first: usize,
    second: usize,
    /// Share of the first link that is compared, from its beginning.
    first_until: f64,
}

/// The links of an arm, with its target.
#[derive(Clone, Debug, PartialEq)]
pub struct Links {
    flange_from_target: Pose<f64>,
    /// Radii of links 0 to n + 1, metres.
    radii: Vec<f64>,
    pairs: Vec<Pair>,
    source: RadiusSource,
    reach: f64,
}

/// Positions of an arm's links and target, in the base frame.
#[derive(Clone, Debug)]
pub struct Stance {
    /// Segments of links 0 to n + 1.
    pub links: Vec<Segment>,
    /// Origins of the joint frames, `base_from_joint`, before the joints move.
    pub joints: Vec<Vector3<f64>>,
    /// Frame of the target in the base frame.
    pub base_from_target: Pose<f64>,
}

impl Links {
    /// Creates the links of a robot; `chain` leads to the target. A radius in metres replaces those of the description.
    pub fn new(
        robot: &Robot,
        chain: &Poe<f64>,
        flange_from_target: Pose<f64>,
        radius: Option<f64>,
    ) -> Self {
        let frames = &robot.parent_from_joint;
        let reach = reach(robot);
        let usual = robot.link_radius.unwrap_or(RADIUS_SHARE * reach);
        let stated = robot.joints.iter().map(|j| j.link_radius);
        let stated: Vec<Option<f64>> = [None].into_iter().chain(stated).collect();
        let source = match radius {
            Some(_) => RadiusSource::Constraints,
            None if robot.link_radius.is_some() || stated.iter().any(Option::is_some) => {
                RadiusSource::Description
            }
            None => RadiusSource::Reach,
        };
        let mut radii: Vec<f64> = stated
            .into_iter()
            .map(|of_link| radius.or(of_link).unwrap_or(usual))
            .collect();
        // The target is on the last link and gets its radius.
        radii.push(radii[radii.len() - 1]);
        let lengths: Vec<f64> = frames
            .iter()
            .chain([&flange_from_target])
            .map(|frame| frame.translation.norm())
            .collect();
        let mut out = Self {
            flange_from_target,
            pairs: pairs(&radii, &lengths),
            radii,
            source,
            reach,
        };
        out.leave_out_structure(robot, chain);
        out
    }

    /// Returns the radius of every link, base first, metres.
    pub fn radii(&self) -> &[f64] {
        &self.radii
    }

    /// Returns the source of the radii.
    pub fn source(&self) -> RadiusSource {
        self.source
    }

    /// Returns the length of the links from the second joint to the flange, metres.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Returns the positions of the links at joints of the serial chain, rad or m; `chain` leads to the target.
    pub fn stance(&self, chain: &Poe<f64>, serial: &[f64]) -> Stance {
        let (frames, base_from_target) = chain.joint_frames(serial);
        let frames = &frames[..serial.len()];
        let flange = (base_from_target * self.flange_from_target.inverse()).translation;
        let joints: Vec<Vector3<f64>> = frames.iter().map(|f| f.translation).collect();
        let moved =
            frames
                .iter()
                .zip(chain.kinds())
                .zip(serial)
                .map(|((frame, kind), q)| match kind {
                    JointKind::Revolute => frame.translation,
                    JointKind::Prismatic => frame.translation + *q * frame.rotation.column(2),
                });
        let begins = [Vector3::zeros()].into_iter().chain(moved).chain([flange]);
        let ends = joints
            .iter()
            .copied()
            .chain([flange, base_from_target.translation]);
        Stance {
            links: begins
                .zip(ends)
                .map(|(from, to)| Segment { from, to })
                .collect(),
            joints,
            base_from_target,
        }
    }

    /// Returns whether a moving link touches the base (`base`), or another moving link.
    pub fn collide(&self, stance: &Stance, base: bool) -> bool {
        self.pairs
            .iter()
            .any(|pair| (pair.first < BASE_LINKS) == base && self.touches(pair, stance))
    }

    /// Returns the lowest z of the moving links, in the base frame in metres: that of their axes minus their radii. The end
    /// at the second joint is left out, because no joint changes its height.
    pub fn lowest(&self, stance: &Stance) -> f64 {
        let links = stance.links.iter().zip(&self.radii).enumerate();
        links
            .skip(BASE_LINKS)
            .map(|(i, (link, radius))| match i {
                BASE_LINKS => link.to[2] - radius,
                _ => link.from[2].min(link.to[2]) - radius,
            })
            .fold(f64::INFINITY, f64::min)
    }

    fn touches(&self, pair: &Pair, stance: &Stance) -> bool {
        let [first, second] = [pair.first, pair.second].map(|i| &stance.links[i]);
        let inner = Segment {
            to: first.at(pair.first_until),
            ..*first
        };
        inner.distance(second) < self.radii[pair.first] + self.radii[pair.second]
    }

    /// Removes the pairs that touch wherever the arm stands.
    fn leave_out_structure(&mut self, robot: &Robot, chain: &Poe<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let mut pairs = std::mem::take(&mut self.pairs);
        let mut free = vec![false; pairs.len()];
        for _ in 0..STRUCTURE_SAMPLES {
            let joints: Vec<f64> = robot
                .joints
                .iter()
                .map(|joint| {
                    let (lower, upper) = joint.limits.unwrap_or(match joint.kind {
                        JointKind::Revolute => (-std::f64::consts::PI, std::f64::consts::PI),
                        JointKind::Prismatic => (-1.0, 1.0),
                    });
                    lower + (upper - lower) * random.random::<f64>()
                })
                .collect();
            let stance = self.stance(chain, &robot.serial_joints(&joints));
            for (pair, free) in pairs.iter().zip(&mut free) {
                *free |= !self.touches(pair, &stance);
            }
        }
        let mut free = free.into_iter();
        pairs.retain(|_| free.next() == Some(true));
        self.pairs = pairs;
    }
}

/// Returns the length of the links from the second joint to the flange in metres; slides add nothing.
fn reach(robot: &Robot) -> f64 {
    let links = robot.parent_from_joint.iter().skip(BASE_LINKS);
    let behind: f64 = links.map(|frame| frame.translation.norm()).sum();
    // An arm with one joint has no second one.
    match robot.joints.len() {
        1 => robot.parent_from_joint[1].translation.norm(),
        _ => behind,
    }
}

/// Returns the pairs of parts that are compared, for links with these radii and lengths.
fn pairs(radii: &[f64], lengths: &[f64]) -> Vec<Pair> {
    let mut out = Vec::new();
    for second in 2..lengths.len() {
        for first in 0..second {
            let between: f64 = lengths[first + 1..second].iter().sum();
            if between < SHORTEST {
                continue;
            }
            let wanted = 0.5 * NEIGHBOURHOOD * (radii[first] + radii[second]) - between;
            // The distance that is still missing between the two is cut from the end of the first.
            let kept = lengths[first] - wanted.max(0.0);
            if kept > SHORTEST && lengths[second] > SHORTEST {
                out.push(Pair {
                    first,
                    second,
                    first_until: kept / lengths[first],
                });
            }
        }
    }
    out
}

/// Returns the height of the plane that the robot is mounted on, z in its base frame in metres. It is 0 if joint 1 turns
/// about z of the base frame and joint 2 lies above its xy plane; for other arms it is not known.
pub fn mounting_plane(robot: &Robot) -> Option<f64> {
    let first = &robot.parent_from_joint[0];
    let turns = robot.joints[0].kind == JointKind::Revolute;
    let upright = first.rotation[(2, 2)].abs() > UPRIGHT;
    let second = (*first * robot.parent_from_joint[1]).translation[2];
    (turns && upright && second > 0.0).then_some(0.0)
}
