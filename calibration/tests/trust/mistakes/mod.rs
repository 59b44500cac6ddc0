//! Mistakes that people and exporters make, each with the causes that are right for it.

mod joints;
mod order;
mod poses;
mod units;
mod values;

use nalgebra::Vector3;
use poegp_calibration::robot::Robot;
use poegp_calibration::trust::Cause;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::sets::Good;
use crate::table::Table;

type Make = dyn Fn(&Good, &mut ChaCha8Rng) -> Table;

/// Gravity in the base frame of an arm that stands, in m/s².
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Causes that warn; with any other a file is refused.
const WARNED: [Cause; 8] = [
    Cause::Few,
    Cause::Copies,
    Cause::Drift,
    Cause::Outlier,
    Cause::Payload,
    Cause::Noise,
    Cause::Rounding,
    Cause::Frames,
];

/// What may hide a mistake.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum HiddenBy {
    /// They absorb it.
    BaseAndTool,
    /// The joint moves the target by too little.
    Lever,
    /// The arm sags by less.
    Scatter,
}

/// One mistake of one set.
pub struct Mistake {
    pub name: String,
    /// Causes that are right, the most specific first.
    pub right: Vec<Cause>,
    /// Joints, from 1, one of which the text has to name.
    pub joints: Vec<usize>,
    /// A model is possible: a warning is enough.
    pub only_warns: bool,
    /// Why nobody can see it in the file; then it does not count.
    pub unseen: Option<&'static str>,
    /// What may hide it: then it does not count where that does.
    pub hidden_by: Option<HiddenBy>,
    /// The robot that the file is said to be of, where it is another.
    pub robot: Option<Robot>,
    /// Gravity that is stated, in the base frame.
    pub gravity: Vector3<f64>,
    make: Box<Make>,
}

impl Mistake {
    /// The file with the mistake.
    pub fn table(&self, good: &Good, random: &mut ChaCha8Rng) -> Table {
        (self.make)(good, random)
    }

    /// The mistake does not count where `true`.
    fn unseen(&mut self, is_unseen: bool, reason: &'static str) -> &mut Self {
        if is_unseen {
            self.unseen = Some(reason);
        }
        self
    }

    /// A warning is enough where `true`.
    fn warns_if(&mut self, only_warns: bool) -> &mut Self {
        self.only_warns |= only_warns;
        self
    }

    /// Base and tool may absorb the mistake.
    fn unless_absorbed(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::BaseAndTool);
        self
    }

    /// The text has to name one of these joints, from 0.
    fn at(&mut self, joints: &[usize]) -> &mut Self {
        self.joints = joints.iter().map(|j| j + 1).collect();
        self
    }

    /// The joint may move the target by too little.
    fn unless_near(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::Lever);
        self
    }

    /// The payloads may make too small a difference.
    fn unless_small(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::Scatter);
        self
    }

    /// The arm is said to hang.
    fn upside_down(&mut self) -> &mut Self {
        self.gravity = -GRAVITY;
        self
    }

    /// The file is said to be of another robot.
    fn read_as(&mut self, robot: Robot) -> &mut Self {
        self.robot = Some(robot);
        self
    }
}

/// The mistakes of one set.
pub struct List<'a> {
    pub good: &'a Good,
    all: Vec<Mistake>,
}

impl List<'_> {
    /// Adds a mistake that `make` makes in a copy of the table.
    fn add(
        &mut self,
        name: impl Into<String>,
        right: &[Cause],
        make: impl Fn(&mut Table, &mut ChaCha8Rng) + 'static,
    ) -> &mut Mistake {
        self.add_of_set(name, right, move |good, random| {
            let mut table = good.table.clone();
            make(&mut table, random);
            table
        })
    }

    /// Adds a mistake that needs the whole set.
    fn add_of_set(
        &mut self,
        name: impl Into<String>,
        right: &[Cause],
        make: impl Fn(&Good, &mut ChaCha8Rng) -> Table + 'static,
    ) -> &mut Mistake {
        self.all.push(Mistake {
            name: name.into(),
            right: right.to_vec(),
            joints: Vec::new(),
            only_warns: WARNED.contains(&right[0]),
            unseen: None,
            hidden_by: None,
            robot: None,
            gravity: GRAVITY,
            make: Box::new(make),
        });
        self.all.last_mut().expect("just pushed")
    }
}

/// All mistakes that a set can have.
pub fn all(good: &Good) -> Vec<Mistake> {
    let mut list = List {
        good,
        all: Vec::new(),
    };
    units::add(&mut list);
    joints::add(&mut list);
    poses::add(&mut list);
    order::add(&mut list);
    values::add(&mut list);
    list.all
}

/// `count` of the numbers below `n`, in order.
pub fn some(n: usize, count: usize, random: &mut ChaCha8Rng) -> Vec<usize> {
    let mut all: Vec<usize> = (0..n).collect();
    all.shuffle(random);
    all.truncate(count);
    all.sort_unstable();
    all
}

/// A normal number of standard deviation 1.
fn standard(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * libm::log(1.0 - u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
}

/// Three normal numbers of standard deviation `sigma`.
pub fn normal(sigma: f64, random: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sigma * standard(random))
}

/// A vector of length `length` in any direction.
pub fn direction(length: f64, random: &mut ChaCha8Rng) -> Vector3<f64> {
    normal(1.0, random).normalize() * length
}

/// Any orientation, at `distance`.
pub fn any_pose(distance: f64, random: &mut ChaCha8Rng) -> Pose<f64> {
    Pose::from_quaternion(
        standard(random),
        &normal(1.0, random),
        direction(distance, random),
    )
}

/// A pure translation.
pub fn shift(by: Vector3<f64>) -> Pose<f64> {
    Pose {
        translation: by,
        ..Pose::identity()
    }
}

/// A rotation by a vector.
pub fn turn(by: Vector3<f64>) -> Pose<f64> {
    Pose::exp(&Twist {
        linear: Vector3::zeros(),
        angular: by,
    })
}
