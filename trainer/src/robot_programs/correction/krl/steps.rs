//! Follows the lines of KRL: `$TOOL`, `$BASE` and `$IPO_MODE`, `TOOL_DATA` and `BASE_DATA`.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::krl::Reader;
use crate::robot_programs::correction::krl::routines::Routines;
use crate::robot_programs::correction::krl::states::{
    ACTIVE, BASE, COPIES, LOAD, Line, MODE, Named, PENDING, States, TOOL, variable,
};
use crate::robot_programs::correction::program::Location;

/// Commands of `BAS` that set speeds, accelerations and outputs alone.
const SETS_NO_FRAME: [&str; 10] = [
    "#acc_cp",
    "#acc_glue",
    "#acc_ptp",
    "#cp_dat",
    "#group",
    "#out_async",
    "#out_sync",
    "#ptp_dat",
    "#vel_cp",
    "#vel_ptp",
];

/// Index of the routine that begins at a line, by the file and the first token of the line.
type Begins = HashMap<(usize, usize), usize>;

/// Returns a flow without steps in which the keys have their values before the program runs.
fn flow_of_keys() -> Flow<Named> {
    let mut flow = Flow::new();
    for kind in ["tool", "base"] {
        let variable = kind.to_ascii_uppercase();
        let reason = format!("no {kind} is set before it: set ${variable} in the program");
        flow.key(Some(Named::Unknown(reason)), true);
    }
    flow.key(Some(Named::HoldsPart(false)), true);
    for _ in COPIES {
        flow.key(None, true);
    }
    flow.key(Some(Named::OfTool), true);
    for _ in PENDING {
        let reason = "no FDAT_ACT is set before it".to_owned();
        flow.key(Some(Named::Unknown(reason)), true);
    }
    flow
}

/// What a line does before its own step.
struct Evaluated {
    /// Sets the keys that it gives to routines as arguments.
    changes: Vec<Step<Named>>,
    /// Routines that it calls.
    called: Vec<usize>,
}

/// The flow of a program to which lines are added.
struct Following {
    flow: Flow<Named>,
    /// Keys of the numbered tools and bases.
    numbered: BTreeMap<(bool, u32), usize>,
    /// Routine of the line.
    routine: usize,
    /// Routine with what calls in interrupts change.
    aside: usize,
    /// Keys that the spline around the line sets.
    of_spline: Vec<usize>,
}

impl Following {
    fn push(&mut self, step: Step<Named>, location: Location) -> usize {
        self.flow.push(self.routine, step, location)
    }

    /// Adds the calls of a line.
    fn evaluate(&mut self, line: &Evaluated, location: Location) {
        // A routine may change its arguments before it uses them by another name.
        let calls = line.called.iter().map(|index| Step::Call(vec![*index]));
        let changes = || line.changes.iter().cloned();
        for step in changes().chain(calls).chain(changes()) {
            self.push(step, location);
        }
    }

    /// Adds the calls of a line that declares an interrupt: they run at any time.
    fn interrupt(&mut self, line: &Evaluated, location: Location) {
        for index in &line.called {
            self.flow.interrupts(*index);
        }
        for step in line.changes.clone() {
            self.flow.push(self.aside, step, location);
        }
    }

    fn begin_spline(&mut self, set: &[(usize, Named)]) {
        self.of_spline.extend(set.iter().map(|(key, _)| *key));
    }

    /// Returns the keys that the spline has set; what they hold behind it, at `line`, is not certain.
    fn end_spline(&mut self, line: &str) -> Vec<(usize, Named)> {
        let value = |key: usize| {
            let name = variable(key);
            let reason = "is not certain after a spline that sets it, which ends at";
            Named::Unknown(format!("{name} {reason} {line}"))
        };
        let keys = self.of_spline.drain(..);
        keys.map(|key| (key, value(key))).collect()
    }

    /// Gives a key a value, and the key beside it what the data of that number hold here.
    fn assign(&mut self, key: usize, value: Named, location: Location) {
        // The key of the value that the data have here, and whether it is that of a tool.
        let copied = match (ACTIVE.iter().position(|own| *own == key), &value) {
            (Some(kind @ (TOOL | BASE)), Named::Number(_)) => Some((COPIES[kind], kind)),
            _ => None,
        };
        let pending = PENDING[..2].iter().position(|own| *own == key);
        let copied = copied.or(pending.map(|kind| (PENDING[3 + kind], kind)));
        let data = match value {
            Named::Number(number) => copied
                .and_then(|(_, kind)| self.numbered.get(&(kind == TOOL, number)))
                .copied(),
            _ => None,
        };
        self.push(Step::Set(key, Some(value)), location);
        if let (Some((copy, _)), Some(data)) = (copied, data) {
            self.push(Step::Copy(copy, data), location);
        }
        // BAS copies the data as they are then, not as they were when FDAT_ACT was set.
        let mut numbered = self.numbered.iter();
        if let Some(((is_tool, _), _)) = numbered.find(|(_, own)| **own == key) {
            let copy = PENDING[3 + usize::from(!is_tool)];
            self.push(Step::Set(copy, None), location);
        }
    }
}

impl Reader<'_> {
    /// Follows the lines of all routines.
    pub(super) fn states(&self, all: &[Line]) -> States {
        let mut flow = flow_of_keys();
        let numbered = self.numbered_keys(&mut flow, all);
        let (routines, begins) = self.routines(&mut flow, all);
        let aside = flow.routine();
        flow.interrupts(aside);
        let mut following = Following {
            flow,
            numbered,
            routine: 0,
            aside,
            of_spline: Vec::new(),
        };
        let mut steps = Vec::with_capacity(all.len());
        for line in all {
            let begin = begins.get(&(line.file, line.from)).copied();
            let text = self.texts[line.file];
            let word = text.name(line.from);
            if let Some(index) = begin {
                following.routine = index;
            }
            let location = self.location(line.file, line.from);
            let changes = self.given_keys(*line, &following.numbered).into_iter();
            let changes = changes.map(|(key, value)| Step::Set(key, Some(value)));
            let evaluated = Evaluated {
                changes: changes.collect(),
                called: match begin {
                    None => self.called(*line, &routines),
                    Some(_) => Vec::new(),
                },
            };
            let is_interrupt = (line.from..line.end.min(line.from + 2))
                .any(|at| matches!(text.name(at).as_str(), "interrupt" | "trigger"));
            match is_interrupt {
                true => following.interrupt(&evaluated, location),
                false => following.evaluate(&evaluated, location),
            }
            let step = self.step(*line, &word);
            let is_loop = matches!(step, Step::Loop);
            steps.push(following.push(step, location));
            // The condition of a loop is evaluated before each pass.
            if is_loop {
                following.evaluate(&evaluated, location);
            }
            let mut set = self.set(*line, &word, &following.numbered);
            match word.as_str() {
                "spline" | "ptp_spline" => following.begin_spline(&set),
                "endspline" => set.extend(following.end_spline(&self.program.line_of(location))),
                "end" | "endfct" => following.of_spline.clear(),
                _ => {}
            }
            for (key, value) in set {
                following.assign(key, value, location);
            }
            if self.loads_frame_data(*line) {
                for (to, from) in ACTIVE.into_iter().zip(PENDING) {
                    following.push(Step::Copy(to, from), location);
                }
            }
            if matches!(word.as_str(), "end" | "endfct" | "enddat") {
                following.routine = 0;
            }
        }
        States {
            certain: following.flow.certain(),
            numbered: following.numbered,
            steps,
        }
    }

    /// Adds the routines of all files; also returns at which line each begins, by the file and the first token.
    fn routines(&self, flow: &mut Flow<Named>, all: &[Line]) -> (Routines, Begins) {
        let mut begins = Begins::new();
        let mut routines = Routines::new();
        for line in all.iter().filter(|line| self.is_code(line.file)) {
            if let Some((name, is_global)) = self.defined(*line) {
                let is_first = routines.iter().all(|(file, ..)| *file != line.file);
                let index = flow.routine();
                begins.insert((line.file, line.from), index);
                routines.push((line.file, name, is_first || is_global, index));
            }
        }
        (routines, begins)
    }

    /// Adds a key for each tool and base that the code sets. Before that they have their value of a data list; where there
    /// is none, that of the code, if it is always the same.
    fn numbered_keys(&self, flow: &mut Flow<Named>, all: &[Line]) -> BTreeMap<(bool, u32), usize> {
        let mut values: BTreeMap<(bool, u32), Vec<Named>> = BTreeMap::new();
        for line in all.iter().filter(|line| self.is_code(line.file)) {
            if let Some((is_tool, number, found)) = self.numbered_frame(*line) {
                let values = values.entry((is_tool, number)).or_default();
                values.push(found.map_or_else(Named::Unknown, Named::Written));
            }
            for (is_tool, number) in self.given_numbered(*line) {
                let given = self.numbers_of(is_tool).into_iter();
                let all: Vec<u32> = match number {
                    Some(number) => vec![number],
                    None => given.collect(),
                };
                let unknown = || Named::Unknown("the program changes it".to_owned());
                for number in all {
                    values.entry((is_tool, number)).or_default().push(unknown());
                }
            }
        }
        let key = |(name, values): ((bool, u32), Vec<Named>)| {
            let declared = self.numbered.get(&name).map(|d| d.value.clone());
            let initial = match declared {
                Some(found) => Some(found.map_or_else(Named::Unknown, Named::Written)),
                None => {
                    let first = values.first().cloned();
                    first.filter(|first| values.iter().all(|value| value == first))
                }
            };
            (name, flow.key(initial, true))
        };
        values.into_iter().map(key).collect()
    }

    /// Returns the numbers of all tools or bases that the files name.
    fn numbers_of(&self, is_tool: bool) -> BTreeSet<u32> {
        let declared = self.numbered.keys().filter(|key| key.0 == is_tool);
        let names: Vec<&str> = match is_tool {
            true => self.given.tools().map(|(name, _)| name).collect(),
            false => self.given.bases().map(|(name, _)| name).collect(),
        };
        let given = names.iter().filter_map(|name| name.parse().ok());
        declared.map(|key| key.1).chain(given).collect()
    }

    /// Returns what the first word of a line does to the order of the lines.
    fn step(&self, line: Line, word: &str) -> Step<Named> {
        let text = self.texts[line.file];
        match word {
            "if" => Step::Branch,
            "switch" => Step::Cases,
            "else" | "default" => Step::Next(true),
            "case" => Step::Next(false),
            "for" | "while" | "loop" | "repeat" => Step::Loop,
            "endif" | "endswitch" | "endfor" | "endwhile" | "endloop" => Step::End,
            "until" => Step::Until,
            "exit" => Step::Break,
            "return" => Step::Return,
            "goto" => Step::Jump(text.name(line.from + 1)),
            _ if text.is(line.from + 1, b':') && line.end == line.from + 2 => {
                Step::Label(word.to_owned())
            }
            _ => Step::Other,
        }
    }

    /// Returns the keys that a line sets, with their values.
    fn set(
        &self,
        line: Line,
        word: &str,
        numbered: &BTreeMap<(bool, u32), usize>,
    ) -> Vec<(usize, Named)> {
        let Line { file, from, end } = line;
        let text = self.texts[file];
        let equals = text.is(from + 1, b'=');
        let in_part = || Named::Unknown(format!("{word} is changed in part"));
        match word {
            "fdat_act" => {
                let data = match (equals, text.is(from + 2, b'{')) {
                    (true, true) => Some(self.frame_data_of(file, from + 2, end)),
                    (true, false) => self.frame_data.find(&text.name(from + 2), file).cloned(),
                    (false, _) => {
                        let keys = PENDING[..3].iter();
                        return keys.map(|key| (*key, in_part())).collect();
                    }
                };
                let unknown =
                    || Named::Unknown("its frame data are in none of the files".to_owned());
                let (tool, base, is_fixed) = match data {
                    Some(data) => (data.tool, data.base, data.is_fixed_tool),
                    None => (unknown(), unknown(), false),
                };
                let values = [tool, base, Named::HoldsPart(is_fixed)];
                PENDING.into_iter().zip(values).collect()
            }
            "$tool" | "$base" | "$ipo_mode" | "$load" if equals => self.assigned(file, from, end),
            "$tool" => vec![(TOOL, in_part())],
            "$base" => vec![(BASE, in_part())],
            "$load" if text.is(from + 1, b'.') && text.name(from + 2) == "m" => {
                let number = text.number(from + 4).filter(|_| end == from + 5);
                let mass = number.map(|number| Named::Mass(number.value));
                vec![(LOAD, mass.unwrap_or_else(in_part))]
            }
            "bas" if text.is(from + 1, b'(') => self.set_by_command(line),
            "spline" | "ptp_spline" => self.settings_with(line),
            _ if self.is_code(file) => {
                let found = self.numbered_frame(line);
                let set = found.and_then(|(is_tool, number, found)| {
                    let key = numbered.get(&(is_tool, number))?;
                    Some((*key, found.map_or_else(Named::Unknown, Named::Written)))
                });
                set.into_iter().collect()
            }
            _ => Vec::new(),
        }
    }

    /// Returns whether a line copies `FDAT_ACT` to the frames in use.
    fn loads_frame_data(&self, line: Line) -> bool {
        let text = self.texts[line.file];
        let command = text.name(line.from + 2);
        text.name(line.from) == "bas"
            && text.is(line.from + 1, b'(')
            && matches!(command.as_str(), "#ptp_params" | "#cp_params" | "#frames")
    }

    /// Returns the keys that `BAS(…)` sets, with their values.
    fn set_by_command(&self, Line { file, from, .. }: Line) -> Vec<(usize, Named)> {
        let text = self.texts[file];
        let number = text.number(from + 4).filter(|_| text.is(from + 5, b')'));
        let value = number.map_or(
            Named::Unknown("BAS gets a computed number".to_owned()),
            |n| Named::number(n.value),
        );
        let command = text.name(from + 2);
        let unknown = |key: usize| {
            let command = command.to_ascii_uppercase();
            let reason = format!("BAS({command}) may reset {}", variable(key));
            (key, Named::Unknown(reason))
        };
        let mut out = match command.as_str() {
            "#tool" => vec![(TOOL, value)],
            "#base" => vec![(BASE, value)],
            "#load" => return vec![(LOAD, value)],
            "#ptp_params" | "#cp_params" | "#frames" => Vec::new(),
            command if SETS_NO_FRAME.contains(&command) => return Vec::new(),
            command if command.starts_with('#') => vec![unknown(TOOL), unknown(BASE)],
            _ => {
                let computed = || Named::Unknown("BAS gets a computed command".to_owned());
                [TOOL, BASE, MODE].map(|key| (key, computed())).to_vec()
            }
        };
        // With a tool, BAS may set its load in place of the one that the program has set.
        if self.has_loads && command != "#base" {
            out.push(unknown(LOAD));
        }
        out
    }

    /// Returns the keys that a motion sets for itself: `SPTP XP1 WITH $TOOL = STOOL2(FP1), …`.
    pub(super) fn settings_with(&self, line: Line) -> Vec<(usize, Named)> {
        let text = self.texts[line.file];
        let with = (line.from..line.end).find(|at| text.name(*at) == "with");
        let all = with.map_or(Vec::new(), |with| text.arguments(with + 1, line.end));
        let set = |(from, end): (usize, usize)| self.assigned(line.file, from, end);
        all.into_iter().flat_map(set).collect()
    }

    /// Returns the keys that an assignment `$TOOL=…` sets, with their values.
    fn assigned(&self, file: usize, from: usize, end: usize) -> Vec<(usize, Named)> {
        let text = self.texts[file];
        let (name, value) = (text.name(from), text.name(from + 2));
        let (key, list) = match name.as_str() {
            "$tool" => (TOOL, "tool_data"),
            "$base" => (BASE, "base_data"),
            "$ipo_mode" => (MODE, ""),
            "$load" => (LOAD, "load_data"),
            _ => return Vec::new(),
        };
        let is_alone = end == from + 3;
        let argument = text.name(from + 4);
        let data = || self.frame_data.find(&argument, file).cloned();
        if text.is(from + 3, b'(')
            && matches!(value.as_str(), "stool2" | "sbase" | "sipo_mode")
            && let Some(data) = data()
        {
            let mode = Named::HoldsPart(data.is_fixed_tool);
            return match key {
                TOOL => vec![(TOOL, data.tool), (MODE, mode)],
                BASE => vec![(BASE, data.base)],
                _ => vec![(MODE, mode)],
            };
        }
        // $LOAD=SLOAD(FP1.TOOL_NO)
        if key == LOAD
            && value == "sload"
            && text.name(from + 6) == "tool_no"
            && let Some(data) = data()
        {
            return vec![(LOAD, data.tool)];
        }
        let unknown = || Named::Unknown(format!("{} is computed", text.spelling(from)));
        let found = match self.element(file, from + 2) {
            Some((number, behind)) if value == list && behind == end => Named::Number(number),
            _ if key == MODE && is_alone && value.starts_with('#') => {
                Named::HoldsPart(value == "#tcp")
            }
            _ if key == LOAD => {
                let mass = self.mass(file, from + 2, end);
                mass.map_or_else(unknown, Named::Mass)
            }
            _ if value == "$nullframe" && is_alone => Named::Number(0),
            _ if is_alone && let Some(Some(pose)) = self.named_frames.find(&value, file) => {
                Named::Written(*pose)
            }
            _ if key == BASE && is_alone && value == "$world" => Named::Number(0),
            // The frames of bases are seen from the robot.
            _ if key == BASE && is_alone && value == "$robroot" => Named::Written(Pose::identity()),
            _ => self
                .pose(file, from + 2, end)
                .map_or_else(unknown, Named::Written),
        };
        vec![(key, found)]
    }
}
