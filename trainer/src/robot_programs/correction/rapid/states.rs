//! What is certain at the statements of RAPID.

use std::collections::HashMap;

use crate::robot_programs::correction::held::Certain;
use crate::robot_programs::correction::program::{Frame, Location};
use crate::robot_programs::correction::rapid::data::{Part, Setting};

/// Key of a program displacement.
pub const DISPLACED: usize = 0;
/// Keys that say whether configurations are monitored: in joint moves, and in straight moves.
pub const MONITORED: [usize; 2] = [1, 2];
/// Key of the load that GripLoad adds to the tool.
pub const LOADED: usize = 3;

/// Name of a tool or work object, its index among the data of this name, and a part of it.
pub type Slot = (String, usize, Part);

/// What is certain at each statement.
pub struct States {
    /// Contents of all keys at each step.
    pub certain: Certain<Setting>,
    /// Key of each part that the code sets.
    pub keys: HashMap<Slot, usize>,
    /// Step of each statement.
    pub steps: Vec<usize>,
}

/// What the argument of a move stands for.
#[derive(Clone, Debug)]
pub enum Goes {
    /// Index of a target.
    Target(usize),
    /// A parameter of a routine, by the indices of both.
    Parameter((usize, usize)),
}

/// A move that is not corrected itself.
#[derive(Clone, Debug)]
pub struct Other {
    /// Where it goes.
    pub to: Goes,
    /// Tool and work object, where they are certain.
    pub frames: Option<(Frame, Frame)>,
    /// Position of the instruction.
    pub location: Location,
}
