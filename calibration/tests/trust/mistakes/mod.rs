//! Mistakes of people and exporters, each with the causes that the examination should name.

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

/// Gravity in the base frame of an upright arm, m/s².
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Causes that lead to a warning; a file with any other cause is refused.
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

/// What may hide a mistake from the examination.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum HiddenBy {
    /// Base and tool absorb it.
    BaseAndTool,
    /// The joint moves the target by too little.
    Lever,
    /// The sag of the arm is smaller than the scatter.
    Scatter,
}

/// One mistake applied to one set.
pub struct Mistake {
    pub name: String,
    /// The right causes, the most specific first.
    pub right: Vec<Cause>,
    /// Joints, from 1, at least one of which the text must name.
    pub joints: Vec<usize>,
    /// A model can still be calibrated, so a warning is enough.
    pub only_warns: bool,
    /// Why nobody can see the mistake in the file. Such a mistake is not counted.
    pub unseen: Option<&'static str>,
    /// What may hide the mistake. It is not counted in sets where that happens.
    pub hidden_by: Option<HiddenBy>,
    /// The robot that the file is declared to be of, if it is another.
    pub robot: Option<Robot>,
    /// The stated gravity in the base frame.
    pub gravity: Vector3<f64>,
    make: Box<Make>,
}

impl Mistake {
    /// Makes the file with the mistake.
    pub fn table(&self, good: &Good, random: &mut ChaCha8Rng) -> Table {
        (self.make)(good, random)
    }

    /// Marks the mistake as not counted if `is_unseen`.
    fn unseen(&mut self, is_unseen: bool, reason: &'static str) -> &mut Self {
        if is_unseen {
            self.unseen = Some(reason);
        }
        self
    }

    /// Marks a warning as enough if `only_warns`.
    fn warns_if(&mut self, only_warns: bool) -> &mut Self {
        self.only_warns |= only_warns;
        self
    }

    /// States that base and tool may absorb the mistake.
    fn unless_absorbed(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::BaseAndTool);
        self
    }

    /// States that the text must name one of these joints, from 0.
    fn at(&mut self, joints: &[usize]) -> &mut Self {
        self.joints = joints.iter().map(|j| j + 1).collect();
        self
    }

    /// States that the joint may move the target by too little.
    fn unless_near(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::Lever);
        self
    }

    /// States that the change of the payloads may be too small to see.
    fn unless_small(&mut self) -> &mut Self {
        self.hidden_by = Some(HiddenBy::Scatter);
        self
    }

    /// States gravity as if the arm were upside down.
    fn upside_down(&mut self) -> &mut Self {
        self.gravity = -GRAVITY;
        self
    }

    /// Declares the file to be of another robot.
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
    /// Adds a mistake; `make` applies it to a copy of the table.
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

    /// Adds a mistake whose `make` needs the whole set.
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

/// Returns all mistakes that a set can have.
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

/// Draws `count` of the numbers below `n`, in ascending order.
pub fn some(n: usize, count: usize, random: &mut ChaCha8Rng) -> Vec<usize> {
    let mut all: Vec<usize> = (0..n).collect();
    all.shuffle(random);
    all.truncate(count);
    all.sort_unstable();
    all
}

/// Returns a standard normal number.
fn standard(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * libm::log(1.0 - u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
}

/// Returns three normal numbers of standard deviation `sigma`.
pub fn normal(sigma: f64, random: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sigma * standard(random))
}

/// Returns a vector of length `length` in any direction.
pub fn direction(length: f64, random: &mut ChaCha8Rng) -> Vector3<f64> {
    normal(1.0, random).normalize() * length
}

/// Returns a random orientation at `distance`.
pub fn any_pose(distance: f64, random: &mut ChaCha8Rng) -> Pose<f64> {
    Pose::from_quaternion(
        standard(random),
        &normal(1.0, random),
        direction(distance, random),
    )
}

/// Returns a pure translation.
pub fn shift(by: Vector3<f64>) -> Pose<f64> {
    Pose {
        translation: by,
        ..Pose::identity()
    }
}

/// Returns a rotation by a vector.
pub fn turn(by: Vector3<f64>) -> Pose<f64> {
    Pose::exp(&Twist {
        linear: Vector3::zeros(),
        angular: by,
    })
}
