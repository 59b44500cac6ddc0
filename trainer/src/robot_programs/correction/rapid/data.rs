//! RAPID's data: targets, tools and work objects, with what the code assigns to them.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{
    Configuration, Convention, Goal, Location, Posture, SLACK, Says, Stated, Target, WRIST, of_sign,
};
use crate::robot_programs::correction::source::Number;
use crate::robot_programs::correction::tokens::Value;
use crate::robot_programs::dialect::Orientation;

/// RAPID writes 9E9 for an external axis that a robot does not have; larger values than this count as 9E9.
const NO_AXIS: f64 = 8.9e9;

/// A value, or the reason why it is not known.
pub type Known<T> = Result<T, String>;

/// What a statement sets.
#[derive(Clone, Debug, PartialEq)]
pub enum Setting {
    /// A frame.
    Pose(Pose<f64>),
    /// A switch.
    Is(bool),
    /// Mass of a load in kg.
    Load(f64),
    /// It is not known, for this reason.
    Unknown(String),
}

/// A part of a tool or work object that the code may assign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// Whether the robot holds it, or something moves it; comes last, so that it makes the frame unknown.
    Kind,
    /// `tframe` or `uframe`.
    Outer,
    /// `oframe`.
    Object,
    /// Mass of a tool.
    Mass,
}

impl Part {
    /// All parts.
    pub const ALL: [Self; 4] = [Self::Outer, Self::Object, Self::Mass, Self::Kind];
}

/// A tool or work object.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameData {
    /// `tooldata`.
    Tool {
        /// Whether the robot holds it.
        is_held: bool,
        /// `tframe`.
        pose: Known<Pose<f64>>,
        /// Mass in kg.
        mass: Option<f64>,
    },
    /// `wobjdata`.
    Object {
        /// Whether the robot holds it.
        is_held: bool,
        /// Whether a mechanical unit moves it.
        is_moved: bool,
        /// `uframe`.
        user: Known<Pose<f64>>,
        /// `oframe`.
        object: Known<Pose<f64>>,
    },
}

impl FrameData {
    /// Returns whether the data are a tool.
    pub fn is_tool(&self) -> bool {
        matches!(self, Self::Tool { .. })
    }

    /// Reads a written `tooldata`.
    pub fn tool(value: &Value) -> Option<Self> {
        let [is_held, pose, load] = value.list(3)? else {
            return None;
        };
        let mass = match load {
            Value::List(load) => match load.first() {
                Some(Value::Number(mass)) => Some(mass.value),
                _ => None,
            },
            _ => None,
        };
        Some(Self::Tool {
            is_held: is_held.name()? == "true",
            pose: pose_of(pose).ok_or_else(|| "its tframe is computed".to_owned()),
            mass,
        })
    }

    /// Reads a written `wobjdata`.
    pub fn object(value: &Value) -> Option<Self> {
        let [is_held, is_fixed, _, user, object] = value.list(5)? else {
            return None;
        };
        let known = |value: &Value, name: &str| {
            pose_of(value).ok_or_else(|| format!("its {name} is computed"))
        };
        Some(Self::Object {
            is_held: is_held.name()? == "true",
            is_moved: is_fixed.name()? != "true",
            user: known(user, "uframe"),
            object: known(object, "oframe"),
        })
    }

    /// Creates a tool or work object whose values are not known.
    pub fn unknown(kind: &str, reason: &str) -> Option<Self> {
        let pose = Err(reason.to_owned());
        match kind {
            "tooldata" => Some(Self::Tool {
                is_held: true,
                pose,
                mass: None,
            }),
            "wobjdata" => Some(Self::Object {
                is_held: false,
                is_moved: false,
                user: pose,
                object: Ok(Pose::identity()),
            }),
            _ => None,
        }
    }

    /// Returns the tool or work object that every controller has by this name.
    pub fn own(name: &str) -> Option<Self> {
        let pose = Ok(Pose::identity());
        match name {
            "tool0" => Some(Self::Tool {
                is_held: true,
                pose,
                mass: Some(0.0),
            }),
            "wobj0" => Some(Self::Object {
                is_held: false,
                is_moved: false,
                user: pose.clone(),
                object: pose,
            }),
            _ => None,
        }
    }

    /// Returns the parts that the assignment `name.component := value` sets, and their value unless it is computed; `mass` is
    /// that of a load or number.
    pub fn assigned(
        &self,
        component: &str,
        value: &Value,
        mass: Option<f64>,
    ) -> Vec<(Part, Option<Setting>)> {
        let pose = || pose_of(value).map(Setting::Pose);
        match (self, component.split('.').next().unwrap_or("")) {
            (Self::Tool { .. }, "tload") if matches!(component, "tload" | "tload.mass") => {
                vec![(Part::Mass, mass.map(Setting::Load))]
            }
            // Other components of a load leave its mass.
            (Self::Tool { .. }, "tload") => Vec::new(),
            (_, "tframe" | "uframe") if component.contains('.') => vec![(Part::Outer, None)],
            (_, "oframe") if component.contains('.') => vec![(Part::Object, None)],
            (_, "tframe" | "uframe") => vec![(Part::Outer, pose())],
            (_, "oframe") => vec![(Part::Object, pose())],
            (_, "") => {
                let written = match self {
                    Self::Tool { .. } => Self::tool(value),
                    Self::Object { .. } => Self::object(value),
                };
                self.replaced(written.as_ref())
            }
            _ => vec![(Part::Kind, None)],
        }
    }

    /// Returns all parts with the values of another tool or work object that replaces this one.
    pub fn replaced(&self, by: Option<&Self>) -> Vec<(Part, Option<Setting>)> {
        let part = |part: Part| {
            let by = by.filter(|by| by.is_tool() == self.is_tool())?;
            match part {
                Part::Kind => (by.kind() == self.kind()).then_some(Setting::Is(true)),
                Part::Mass => match by {
                    Self::Tool { mass, .. } => mass.map(Setting::Load),
                    Self::Object { .. } => Some(Setting::Is(true)),
                },
                part => by.declared(part),
            }
        };
        Part::ALL.map(|own| (own, part(own))).to_vec()
    }

    /// Returns whether the robot holds it, and whether a mechanical unit moves it.
    fn kind(&self) -> (bool, bool) {
        match self {
            Self::Tool { is_held, .. } => (*is_held, false),
            Self::Object {
                is_held, is_moved, ..
            } => (*is_held, *is_moved),
        }
    }

    /// Returns the declared value of a part; `None` if it is computed.
    pub fn declared(&self, part: Part) -> Option<Setting> {
        let pose = |pose: &Known<Pose<f64>>| pose.as_ref().ok().copied().map(Setting::Pose);
        match (self, part) {
            (_, Part::Kind | Part::Mass) => Some(Setting::Is(true)),
            (Self::Tool { pose: outer, .. } | Self::Object { user: outer, .. }, Part::Outer) => {
                pose(outer)
            }
            (Self::Object { object, .. }, Part::Object) => pose(object),
            (Self::Tool { .. }, Part::Object) => Some(Setting::Is(true)),
        }
    }

    /// Puts the value of a part, or the reason why it is not known.
    pub fn put(&mut self, part: Part, value: Known<Setting>) {
        let pose = match value {
            Ok(Setting::Pose(pose)) => Ok(pose),
            Ok(Setting::Load(kg)) => {
                if let Self::Tool { mass, .. } = self {
                    *mass = Some(kg);
                }
                return;
            }
            // The part is as declared.
            Ok(Setting::Is(_)) => return,
            Ok(Setting::Unknown(reason)) | Err(reason) => Err(reason),
        };
        match (self, part) {
            (Self::Tool { mass, .. }, Part::Mass) => *mass = None,
            (Self::Object { object, .. }, Part::Object) => *object = pose,
            (Self::Object { .. }, Part::Mass) | (Self::Tool { .. }, Part::Object) => {}
            (Self::Tool { pose: outer, .. } | Self::Object { user: outer, .. }, _) => {
                *outer = pose;
            }
        }
    }
}

/// Reads a pose `[[x, y, z], [q1, q2, q3, q4]]`.
pub fn pose_of(value: &Value) -> Option<Pose<f64>> {
    let [position, orientation] = value.list(2)? else {
        return None;
    };
    let p = position.numbers::<3>()?.map(|n| 1e-3 * n.value);
    let q = orientation.numbers::<4>()?.map(|n| n.value);
    Some(Pose {
        rotation: Orientation::Quaternion.rotation(&q)?,
        translation: Vector3::new(p[0], p[1], p[2]),
    })
}

/// Result of reading a list as a target.
pub enum Read {
    Target(Box<Target>),
    /// A target that cannot be corrected, and the reason.
    Left(String),
    /// The list is no target.
    Nothing,
}

/// Reads a written `robtarget` `[[3], [4], [4], [6]]` or `jointtarget` `[[6], [6]]`; the digits are lengths of lists.
pub fn target(value: &Value, location: Location) -> Read {
    let Value::List(parts) = value else {
        return Read::Nothing;
    };
    let lengths: Vec<usize> = parts
        .iter()
        .map(|part| match part {
            Value::List(values) => values.len(),
            _ => 0,
        })
        .collect();
    let goal = match lengths[..] {
        [6, 6] => parts[0]
            .numbers::<6>()
            .map(|n| (Goal::Joints(n.to_vec()), None)),
        [3, 4, 4, 6] => pose_goal(parts),
        _ => return Read::Nothing,
    };
    let Some((goal, configuration)) = goal else {
        return Read::Left("a part of it is computed".to_owned());
    };
    let Some(axes) = parts.last().and_then(|axes| axes.numbers::<6>()) else {
        return Read::Left("an external axis of it is computed".to_owned());
    };
    if axes.iter().any(|axis| axis.value.abs() < NO_AXIS) {
        return Read::Left("it has external axes".to_owned());
    }
    Read::Target(Box::new(Target::new(location, goal, configuration)))
}

/// Returns whether a value has an external axis that is not at zero: a target, a list of axes, or one of them. `None` for a
/// value that is computed.
pub fn moves_axes(value: &Value) -> Option<bool> {
    let is_moved = |axis: f64| axis != 0.0 && axis.abs() < NO_AXIS;
    match value {
        Value::Number(axis) => Some(is_moved(axis.value)),
        Value::List(parts) => match parts.last()? {
            axes @ Value::List(_) => moves_axes(axes),
            _ => {
                let mut axes = parts.iter().map(Value::number);
                axes.try_fold(false, |any, axis| Some(any || is_moved(axis?)))
            }
        },
        _ => None,
    }
}

fn pose_goal(parts: &[Value]) -> Option<(Goal, Option<Configuration>)> {
    let orientation: [Number; 4] = parts[1].numbers()?;
    let goal = Goal::Pose {
        position: parts[0].numbers()?,
        orientation: orientation.to_vec(),
    };
    let [first, fourth, sixth, rest] = parts[2].numbers::<4>()?;
    // The configuration counts the quarter turns of axes 1, 4 and 6.
    let quarter = std::f64::consts::FRAC_PI_2;
    let bound = |(joint, number): (usize, Number)| {
        let lower = quarter * number.value;
        (joint, lower - SLACK, lower + quarter + SLACK)
    };
    let mut bounds = [(0, first), (3, fourth), (5, sixth)].map(bound).to_vec();
    // cfx is a sum: 4 behind axis 1, 2 behind the lower arm, 1 for a negative axis 5. Robots that do not use it have 0.
    let posture = (0..=7u32).find(|cfx| rest.value == f64::from(*cfx));
    let posture = posture.map(|bits| Posture {
        convention: Convention::Cfx,
        bits,
        is_certain: bits != 0,
    });
    if let Some(cfx) = posture.filter(|posture| posture.is_certain) {
        bounds.push(of_sign(WRIST, cfx.bits % 2 == 1));
    }
    let stated = [(0, first), (3, fourth), (5, sixth)].map(|(joint, number)| Stated {
        number,
        says: Says::Quarter(joint),
    });
    let configuration = Configuration {
        stated: stated.to_vec(),
        rest: Some(rest),
        posture,
        ..Configuration::monitored(bounds)
    };
    Some((goal, Some(configuration)))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector3;

    use crate::robot_programs::correction::frames::FrameFile;
    use crate::robot_programs::correction::rapid::read;
    use crate::robot_programs::correction::source::Source;

    /// x of the object frame is y of the user frame, whose x is z of the base.
    #[test]
    fn the_object_stands_in_its_user_frame() {
        let half = "0.70710678";
        let text = format!(
            "MODULE M\nPERS wobjdata w:=[FALSE,TRUE,\"\",[[100,0,0],[{half},0,-{half},0]],[[0,10,0],[{half},0,0,{half}]]];\n\
             PROC main()\nMoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0\\WObj:=w;\nENDPROC\nENDMODULE\n"
        );
        let source = Source::new(Path::new("m.mod"), text.into_bytes(), true);
        let program = read(vec![source], &FrameFile::default()).unwrap();
        let frame = program.frames.iter().find(|frame| !frame.is_tool).unwrap();
        let point = frame
            .pose
            .transform_point(&Vector3::new(0.001, 0.002, 0.003));
        // In the user frame (-2, 11, 3): turned about y by -90°, and 100 mm along x.
        let expected = Vector3::new(0.097, 0.011, -0.002);
        assert!((point - expected).norm() < 1e-7, "{point}");
    }
}
