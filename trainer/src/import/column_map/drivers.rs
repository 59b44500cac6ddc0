//! Names and units that robot drivers give the columns of joints.

use crate::import::column_map::tables::JointUnit;

/// A driver and its columns.
#[derive(Clone, Copy, Debug)]
pub struct Driver {
    /// Name in a map.
    pub name: &'static str,
    names: Names,
    /// The unit that the driver writes.
    pub unit: JointUnit,
}

#[derive(Clone, Copy, Debug)]
enum Names {
    /// These, all of them, base first.
    Fixed(&'static [&'static str]),
    /// As many as the header has; `#` is the number, from the one given.
    Numbered(&'static str, usize),
}

/// All drivers. Those with the names of a controller have its unit, those of ROS radians.
const DRIVERS: [Driver; 10] = [
    Driver {
        name: "poegp",
        names: Names::Numbered("q#_deg", 1),
        unit: JointUnit::Deg,
    },
    Driver {
        name: "kuka",
        names: Names::Numbered("A#", 1),
        unit: JointUnit::Deg,
    },
    Driver {
        name: "abb",
        names: Names::Numbered("rax_#", 1),
        unit: JointUnit::Deg,
    },
    Driver {
        name: "fanuc",
        names: Names::Numbered("J#", 1),
        unit: JointUnit::Deg,
    },
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
    Driver {
        name: "ur-rtde",
        names: Names::Numbered("actual_q_#", 0),
        unit: JointUnit::Rad,
    },
    Driver {
        name: "ur-rtde-target",
        names: Names::Numbered("target_q_#", 0),
        unit: JointUnit::Rad,
    },
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
    Driver {
        name: "panda",
        names: Names::Numbered("panda_joint#", 1),
        unit: JointUnit::Rad,
    },
    Driver {
        name: "fr3",
        names: Names::Numbered("fr3_joint#", 1),
        unit: JointUnit::Rad,
    },
];

impl Driver {
    /// The driver with this name.
    pub fn named(name: &str) -> Option<Self> {
        DRIVERS.into_iter().find(|driver| driver.name == name)
    }

    /// The names of all drivers.
    pub fn all() -> String {
        DRIVERS
            .map(|driver| format!("{:?}", driver.name))
            .join(", ")
    }

    /// Its columns in a header, the first at least: what the header lacks is to be named.
    pub fn columns(self, has: impl Fn(&str) -> bool) -> Vec<String> {
        match self.names {
            Names::Fixed(names) => names.iter().map(|name| (*name).to_owned()).collect(),
            Names::Numbered(pattern, first) => {
                let name = |n: usize| pattern.replace('#', &n.to_string());
                let count = (first..).take_while(|n| has(&name(*n))).count().max(1);
                (first..first + count).map(name).collect()
            }
        }
    }
}
