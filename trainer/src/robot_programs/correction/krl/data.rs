//! KRL's data by number: tools, bases and loads, and the bases that an external kinematic moves.

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::krl::states::{Declared, Line, Named};
use crate::robot_programs::correction::krl::{FrameData, Reader};
use crate::robot_programs::correction::program::Location;
use crate::robot_programs::dialect::Orientation;

impl Reader<'_> {
    /// Notes the tool, base or load of a number that a line declares, or that an external kinematic moves a base.
    pub(super) fn declare_numbered(&mut self, line: Line) {
        let text = self.texts[line.file];
        let (at, _) = self.declared(line);
        let location = self.location(line.file, at);
        let name = text.name(at);
        if self.is_code(line.file) {
            let is_command = name == "bas" && text.name(at + 2) == "#load";
            self.has_loads |= name == "$load" || is_command;
            return;
        }
        if name == "machine_frame_dat" {
            self.declare_kinematic(line, at);
        } else if let Some((is_tool, number, value)) = self.numbered_frame(line) {
            let key = (is_tool, number);
            let old = self.numbered.remove(&key);
            let new = self.declaration(old, value, location);
            self.numbered.insert(key, new);
        } else if name == "load_data"
            && let Some((number, behind)) = self.element(line.file, at)
        {
            let mass = match text.is(behind, b'=') {
                true => self.mass(line.file, behind + 1, line.end),
                false => None,
            };
            let line = self.program.line_of(location);
            let value = mass.ok_or(format!("it is computed at {line}"));
            let old = self.loads.remove(&number);
            let new = self.declaration(old, value, location);
            self.loads.insert(number, new);
        }
    }

    /// Returns what holds once a second line declares a value. The values of the program itself take precedence.
    fn declaration<T: PartialEq>(
        &self,
        old: Option<Declared<T>>,
        value: Result<T, String>,
        at: Location,
    ) -> Declared<T> {
        let Some(mut old) = old else {
            let other = None;
            return Declared { value, at, other };
        };
        let is_own = |at: Location| self.texts[at.file].source.is_corrected;
        if old.value != value {
            if is_own(at) || at.file == old.at.file {
                let line = self.program.line_of(at);
                old.value = Err(format!("it is set again at {line}"));
            } else if !is_own(old.at) {
                old.other.get_or_insert(at);
            }
        }
        old
    }

    /// Returns the error for a value that two files declare differently.
    pub(super) fn contradiction<T>(
        &self,
        name: &str,
        declared: Option<&Declared<T>>,
    ) -> Result<(), InputError> {
        let Some((Declared { at, .. }, other)) = declared.and_then(|d| Some((d, d.other?))) else {
            return Ok(());
        };
        let first = self.program.line_of(*at);
        Err(self.program.sources[other.file]
            .error(
                other.at,
                format!("another {name} than at {first}"),
                "the same value in all files of --with",
            )
            .with_help("give the files of one controller alone"))
    }

    /// Notes that a base stands on an external kinematic: `MACHINE_FRAME_DAT[2]={MACH_DEF_INDEX 2,PARENT[] "WORLD",…}`.
    fn declare_kinematic(&mut self, line: Line, at: usize) {
        let text = self.texts[line.file];
        let Some((number, behind)) = self.element(line.file, at) else {
            return;
        };
        let is_zero = |at: usize| text.number(at).is_some_and(|n| n.value == 0.0);
        let is_fixed = text.is(behind, b'=')
            && (behind..line.end).all(|at| match text.name(at).as_str() {
                "mach_def_index" => is_zero(at + 1),
                "parent" => {
                    let parent = text.spelling(at + 3).to_ascii_lowercase();
                    matches!(parent.trim_matches(['"', ' ']), "" | "world")
                }
                _ => true,
            });
        let line = self.program.line_of(self.location(line.file, at));
        if !is_fixed {
            self.moved.insert(number, line);
        }
    }

    /// Notes that the code changes the load at a token, so that its mass is not certain.
    pub(super) fn forget_load(&mut self, file: usize, at: usize) {
        let text = self.texts[file];
        let location = self.location(file, at);
        let line = self.program.line_of(location);
        let numbers = match self.element(file, at) {
            // Other components of a load leave its mass.
            Some((_, behind)) if text.is(behind, b'.') && text.name(behind + 1) != "m" => return,
            Some((number, _)) => vec![number],
            None => {
                let given = self.given.tools().filter_map(|(name, _)| name.parse().ok());
                self.loads.keys().copied().chain(given).collect()
            }
        };
        for number in numbers {
            let unknown = Declared {
                value: Err(format!("it is changed at {line}")),
                at: location,
                other: None,
            };
            self.loads.insert(number, unknown);
        }
    }

    /// Returns the mass in kg of a written load: `{M 2.5,CM {…},J {…}}`.
    pub(super) fn mass(&self, file: usize, from: usize, end: usize) -> Option<f64> {
        let map = self.components(file, from, end)?;
        let number = self.texts[file].number(*map.get("m")?)?;
        Some(number.value)
    }

    /// Returns the payload in kg of a tool: that of `$LOAD` if the program sets it, else that of the tool.
    pub(super) fn payload(
        &self,
        load: &Result<Named, String>,
        tool: &Result<Named, String>,
    ) -> Option<f64> {
        let number = match (load, tool) {
            (Ok(Named::Mass(kg)), _) => return Some(*kg).filter(|kg| *kg >= 0.0),
            (Ok(Named::Number(number)), _) => *number,
            (Ok(Named::OfTool), Ok(Named::Number(number))) => *number,
            _ => return None,
        };
        let given = || self.given.named(&number.to_string(), true)?.payload_kg;
        match self.loads.get(&number).map(|load| &load.value) {
            // A negative mass stands for one that nobody has stated.
            Some(Ok(kg)) if *kg >= 0.0 => Some(*kg),
            Some(Err(_)) => None,
            _ => given(),
        }
    }

    pub(super) fn pose(&self, file: usize, from: usize, end: usize) -> Option<Pose<f64>> {
        let map = self.components(file, from, end)?;
        let n = self.all_of(file, &map, &["x", "y", "z", "a", "b", "c"])?;
        let n: Vec<f64> = n.iter().map(|n| n.value).collect();
        Some(Pose {
            rotation: Orientation::TurnedZyx.rotation(&n[3..])?,
            translation: Vector3::new(n[0], n[1], n[2]) / 1000.0,
        })
    }

    /// Returns the number and the value of the tool (true) or base that a line `TOOL_DATA[n]=…` sets.
    pub(super) fn numbered_frame(
        &self,
        line: Line,
    ) -> Option<(bool, u32, Result<Pose<f64>, String>)> {
        let text = self.texts[line.file];
        let (at, _) = self.declared(line);
        let is_tool = match text.name(at).as_str() {
            "tool_data" => true,
            "base_data" => false,
            _ => return None,
        };
        let (number, behind) = self.element(line.file, at)?;
        let pose = match text.is(behind, b'=') {
            true => self.pose(line.file, behind + 1, line.end),
            false => None,
        };
        let at_line = self.program.line_of(self.location(line.file, at));
        Some((
            is_tool,
            number,
            pose.ok_or(format!("it is computed at {at_line}")),
        ))
    }

    pub(super) fn frame_data_of(&self, file: usize, from: usize, end: usize) -> FrameData {
        let text = self.texts[file];
        let map = self.components(file, from, end).unwrap_or_default();
        let number = |name: &str| {
            let found = map.get(name).and_then(|at| text.number(*at));
            found.map_or(
                Named::Unknown("its frame data are computed".to_owned()),
                |n| Named::number(n.value),
            )
        };
        let is_fixed_tool = map
            .get("ipo_frame")
            .is_some_and(|at| text.name(*at) == "#tcp");
        FrameData {
            tool: number("tool_no"),
            base: number("base_no"),
            is_fixed_tool,
        }
    }
}
