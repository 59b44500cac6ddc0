//! RAPID's data by name: targets, tools and work objects, with what the code assigns to them.

use std::collections::HashMap;

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
#[derive(Clone, Debug)]
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
            (_, "") => Part::ALL.map(|part| (part, None)).to_vec(),
            _ => vec![(Part::Kind, None)],
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
            Err(reason) => Err(reason),
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
    Left(&'static str),
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
        return Read::Left("a part of it is computed");
    };
    let Some(axes) = parts.last().and_then(|axes| axes.numbers::<6>()) else {
        return Read::Left("an external axis of it is computed");
    };
    if axes.iter().any(|axis| axis.value.abs() < NO_AXIS) {
        return Read::Left("it has external axes");
    }
    Read::Target(Box::new(Target::new(location, goal, configuration)))
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

/// Data that a statement may change.
pub struct Change {
    /// Name in lower case; `None` for all data.
    pub name: Option<String>,
    /// Whether it may be data of any module and routine, as it is named in a string.
    pub is_anywhere: bool,
    /// Whether the change is in the files; otherwise it may be.
    pub is_certain: bool,
}

impl Change {
    /// Creates a change of the data to which a name refers where it stands.
    pub fn of(name: String, is_certain: bool) -> Self {
        Self {
            name: Some(name),
            is_anywhere: false,
            is_certain,
        }
    }
}

/// Data of one name.
#[derive(Clone, Debug)]
struct Named<T> {
    file: usize,
    routine: usize,
    is_local: bool,
    value: T,
}

/// Data by module file, routine and name. Data of a routine hide those of its module, which hide those of other modules;
/// local ones are seen in their own module alone.
#[derive(Clone, Debug)]
pub struct Names<T>(HashMap<String, Vec<Named<T>>>);

impl<T> Default for Names<T> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

impl<T> Names<T> {
    /// Adds data of a file and routine; routine 0 is the module.
    pub fn add(&mut self, name: &str, file: usize, routine: usize, is_local: bool, value: T) {
        self.0.entry(name.to_owned()).or_default().push(Named {
            file,
            routine,
            is_local,
            value,
        });
    }

    /// Returns whether a name refers to data of the file `other`.
    pub fn is_of(&self, name: &str, file: usize, routine: usize, other: usize) -> bool {
        let found = self.find_with_index(name, file, routine);
        found.is_some_and(|(index, _)| self.0[name][index].file == other)
    }

    /// Returns the data that a statement in a routine of a file changes: names, and indices among the data of the name.
    pub fn changed(&self, change: &Change, file: usize, routine: usize) -> Vec<(String, usize)> {
        let names = match &change.name {
            Some(name) => vec![name],
            None => {
                let mut names: Vec<&String> = self.0.keys().collect();
                names.sort();
                names
            }
        };
        let mut out = Vec::new();
        for name in names {
            let found = self.find_with_index(name, file, routine);
            let all = 0..self.0.get(name).map_or(0, Vec::len);
            let is_it = |index: &usize| {
                change.is_anywhere || found.is_some_and(|(found, _)| found == *index)
            };
            out.extend(all.filter(is_it).map(|index| (name.clone(), index)));
        }
        out
    }

    /// Returns data by their index among the data of their name.
    pub fn at(&self, name: &str, index: usize) -> Option<&T> {
        Some(&self.0.get(name)?.get(index)?.value)
    }

    /// Returns the same, to be changed.
    pub fn at_mut(&mut self, name: &str, index: usize) -> Option<&mut T> {
        Some(&mut self.0.get_mut(name)?.get_mut(index)?.value)
    }

    /// Returns the data to which a name refers in a routine of a file.
    pub fn find(&self, name: &str, file: usize, routine: usize) -> Option<&T> {
        self.find_with_index(name, file, routine).map(|(_, v)| v)
    }

    /// Returns the same, and its index among the data of its name.
    pub fn find_with_index(&self, name: &str, file: usize, routine: usize) -> Option<(usize, &T)> {
        let all = self.0.get(name)?;
        let in_file = |r: usize| all.iter().position(|n| n.file == file && n.routine == r);
        let others = || all.iter().position(|n| n.routine == 0 && !n.is_local);
        let index = in_file(routine).or_else(|| in_file(0)).or_else(others)?;
        all.get(index).map(|named| (index, &named.value))
    }
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
