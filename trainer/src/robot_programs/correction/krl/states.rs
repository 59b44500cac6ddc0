//! The lines of KRL, and what is certain at them.

use std::collections::BTreeMap;

use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::held::Certain;
use crate::robot_programs::correction::program::Location;

/// A line of a file: its tokens from the first to the one behind the last.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    pub file: usize,
    pub from: usize,
    pub end: usize,
}

/// Keys of tool, base, and of whether the robot holds the part.
pub const TOOL: usize = 0;
pub const BASE: usize = 1;
pub const MODE: usize = 2;
/// Keys of the values that tool and base had in `TOOL_DATA[n]` and `BASE_DATA[n]` when they were set: later changes of these
/// do not reach them.
pub const COPIES: [usize; 2] = [3, 4];
/// Key of the load that the program states.
pub const LOAD: usize = 5;
/// Keys of `FDAT_ACT`: tool, base, whether the robot holds the part, and the values of tool and base as above. They hold for
/// motions once `BAS` has copied them.
pub const PENDING: [usize; 5] = [6, 7, 8, 9, 10];
/// Keys to which `BAS` copies those of [`PENDING`].
pub const ACTIVE: [usize; 5] = [TOOL, BASE, MODE, COPIES[0], COPIES[1]];

/// Returns the name of the variable of a key.
pub fn variable(key: usize) -> &'static str {
    match key {
        TOOL => "$TOOL",
        BASE => "$BASE",
        MODE => "$IPO_MODE",
        _ => "$LOAD",
    }
}

/// A value as a line names it.
#[derive(Clone, Debug, PartialEq)]
pub enum Named {
    /// Number of the tool or base.
    Number(u32),
    /// Pose that is written in the line.
    Written(Pose<f64>),
    /// Whether the robot holds the part (`#TCP`).
    HoldsPart(bool),
    /// The load is that of the tool.
    OfTool,
    /// Mass of the load in kg.
    Mass(f64),
    /// The tool or base is not known, for this reason.
    Unknown(String),
}

impl Named {
    /// Returns the tool or base of this number.
    pub fn number(number: f64) -> Self {
        match number >= 0.0 {
            true => Self::Number(number as u32),
            false => Self::Unknown(format!("there is no tool or base {number}")),
        }
    }
}

/// A value that a data list declares.
#[derive(Clone, Debug)]
pub struct Declared<T> {
    /// The value, or the reason why it is not known.
    pub value: Result<T, String>,
    /// First declaration.
    pub at: Location,
    /// Declaration of another value in a second file, where neither file is part of the program.
    pub other: Option<Location>,
}

/// What is certain at each line.
pub struct States {
    pub certain: Certain<Named>,
    /// Keys of `TOOL_DATA` (true) and `BASE_DATA` (false) by number, where the code sets them.
    pub numbered: BTreeMap<(bool, u32), usize>,
    /// Step of each line.
    pub steps: Vec<usize>,
}
