//! Names and units of the joint columns that robot drivers write.

use poegp_protocol::limits::MAX_JOINTS;

use crate::import::column_map::units::JointUnit;

/// A robot driver and its joint columns.
#[derive(Clone, Copy, Debug)]
pub struct Driver {
    /// Name of the driver in a map.
    pub name: &'static str,
    names: Names,
    /// Unit in which the driver writes joints.
    pub unit: JointUnit,
}

#[derive(Clone, Copy, Debug)]
enum Names {
    /// All of these names, base first.
    Fixed(&'static [&'static str]),
    /// Up to the last one that the header has; `#` stands for the number of the joint, which starts at the given one.
    Numbered(&'static str, usize),
}

/// All drivers. Those named after a controller use its unit, those of ROS use radians.
const DRIVERS: [Driver; 10] = [
    Driver::numbered("poegp", "q#_deg", 1, JointUnit::Deg),
    Driver::numbered("kuka", "A#", 1, JointUnit::Deg),
    Driver::numbered("abb", "rax_#", 1, JointUnit::Deg),
    Driver::numbered("fanuc", "J#", 1, JointUnit::Deg),
    Driver {
        name: "ur",
        names: Names::Fixed(&[
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ]),
        unit: JointUnit::Rad,
    },
    Driver::numbered("ur-rtde", "actual_q_#", 0, JointUnit::Rad),
    Driver::numbered("ur-rtde-target", "target_q_#", 0, JointUnit::Rad),
    // Yaskawa: the descriptions of the ROS packages motoman_*_support with six joints.
    Driver {
        name: "motoman",
        names: Names::Fixed(&[
            "joint_1_s",
            "joint_2_l",
            "joint_3_u",
            "joint_4_r",
            "joint_5_b",
            "joint_6_t",
        ]),
        unit: JointUnit::Rad,
    },
    // Franka: franka_ros and franka_ros2.
    Driver::numbered("panda", "panda_joint#", 1, JointUnit::Rad),
    Driver::numbered("fr3", "fr3_joint#", 1, JointUnit::Rad),
];

impl Driver {
    const fn numbered(
        name: &'static str,
        pattern: &'static str,
        first: usize,
        unit: JointUnit,
    ) -> Self {
        let names = Names::Numbered(pattern, first);
        Self { name, names, unit }
    }

    /// Returns the driver with this name.
    pub fn named(name: &str) -> Option<Self> {
        DRIVERS.into_iter().find(|driver| driver.name == name)
    }

    /// Returns the names of all drivers as a list for messages.
    pub fn all() -> String {
        DRIVERS
            .map(|driver| format!("{:?}", driver.name))
            .join(", ")
    }

    /// Returns the driver's columns in a header: at least the first one, and none left out, so that an error names what the header
    /// lacks.
    pub fn columns(self, has: impl Fn(&str) -> bool) -> Vec<String> {
        match self.names {
            Names::Fixed(names) => names.iter().map(|name| (*name).to_owned()).collect(),
            Names::Numbered(pattern, first) => {
                let name = |n: usize| pattern.replace('#', &n.to_string());
                let last = (first..first + MAX_JOINTS).rfind(|n| has(&name(*n)));
                (first..=last.unwrap_or(first)).map(name).collect()
            }
        }
    }
}
