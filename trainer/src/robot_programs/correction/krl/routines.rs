//! KRL's routines and their calls.

use crate::robot_programs::correction::krl::Reader;
use crate::robot_programs::correction::krl::states::Line;
use crate::robot_programs::correction::program::Location;
use crate::robot_programs::correction::tokens::Kind;

/// The routines of all files: file, name, whether other modules see it, and its index.
pub type Routines = Vec<(usize, String, bool, usize)>;

/// Words before a bracket that are keywords, or routines of every controller.
const OWN: [&str; 74] = [
    "abs",
    "acos",
    "and",
    "atan2",
    "b_and",
    "b_exor",
    "b_not",
    "b_or",
    "bas",
    "case",
    "cast_from",
    "cast_to",
    "cclose",
    "clear_kcpmsg",
    "copen",
    "cos",
    "cread",
    "cwrite",
    "eb",
    "ek",
    "eo",
    "err_raise",
    "exists_kcpdlg",
    "exists_kcpmsg",
    "exor",
    "exp",
    "for",
    "forward",
    "get_sig_inf",
    "if",
    "inv_pos",
    "inverse",
    "ir_stopm",
    "log",
    "lk",
    "mbx_rec",
    "not",
    "or",
    "pulse",
    "return",
    "sacc_cp",
    "sacc_jnt",
    "sacc_joint",
    "sapo",
    "sapo_ptp",
    "sbase",
    "sec",
    "set_cd_params",
    "set_kcpdlg",
    "set_kcpmsg",
    "sgear_jerk",
    "sin",
    "sipo_mode",
    "sjerk",
    "sload",
    "sori_typ",
    "sqrt",
    "sread",
    "step",
    "stool2",
    "stradd",
    "strclear",
    "strcomp",
    "strcopy",
    "strdecllen",
    "strfind",
    "strlen",
    "svel_cp",
    "svel_jnt",
    "svel_joint",
    "swrite",
    "switch",
    "tan",
    "use_cm_pro_values",
];
/// More keywords before a bracket.
const KEYWORDS: [&str; 5] = ["to", "until", "varstate", "when", "while"];

impl Reader<'_> {
    /// Returns the name of the routine that begins at a line, and whether it is global.
    pub(super) fn defined(&self, line: Line) -> Option<(String, bool)> {
        let text = self.texts[line.file];
        let (at, is_global) = self.declared(line);
        if !matches!(text.name(at).as_str(), "def" | "deffct") {
            return None;
        }
        let open = text.find(at, line.end, b"(");
        Some((text.name(open - 1), is_global))
    }

    /// Returns the tokens of the calls in a line.
    fn calls(&self, line: Line) -> Vec<usize> {
        let text = self.texts[line.file];
        let is_call = |at: &usize| {
            let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
            is_name && text.is(at + 1, b'(')
        };
        (line.from..line.end).filter(is_call).collect()
    }

    /// Returns the routines of the files that a line calls.
    pub(super) fn called(&self, line: Line, routines: &Routines) -> Vec<usize> {
        let text = self.texts[line.file];
        let named = |at: usize| {
            let name = text.name(at);
            let all = || routines.iter().filter(|(_, own, ..)| *own == name);
            let own = all().find(|(file, ..)| *file == line.file);
            let found = own.or_else(|| all().find(|(_, _, is_seen, _)| *is_seen));
            found.map(|(.., index)| *index)
        };
        self.calls(line).into_iter().filter_map(named).collect()
    }

    /// Returns the calls of routines that are in none of the files, with their names.
    pub(super) fn unfound(&self, all: &[Line]) -> Vec<(String, Location)> {
        let defined = all.iter().filter_map(|line| self.defined(*line));
        let defined: Vec<String> = defined.map(|(name, _)| name).collect();
        let mut out = Vec::new();
        for line in all.iter().filter(|line| self.defined(**line).is_none()) {
            let text = self.texts[line.file];
            let calls = self.calls(*line).into_iter();
            out.extend(calls.filter_map(|at| {
                let name = text.name(at);
                let is_known = OWN.contains(&name.as_str()) || KEYWORDS.contains(&name.as_str());
                let is_found = is_known || name.starts_with('$') || defined.contains(&name);
                (!is_found).then(|| (text.spelling(at), self.location(line.file, at)))
            }));
        }
        out
    }
}
