//! Reads KRL's points: their components, and the configuration that they state.

use std::collections::{BTreeMap, HashMap};

use crate::robot_programs::correction::krl::Reader;
use crate::robot_programs::correction::program::{
    Configuration, Convention, Goal, Posture, Says, Stated, Target, of_sign,
};
use crate::robot_programs::correction::source::Number;

/// Largest number of turn bits: those of six joints and six external axes.
const MOST_BITS: f64 = 4095.0;

impl Reader<'_> {
    /// Returns the components of a list in braces: the token of each value by the component's name.
    pub(super) fn components(
        &self,
        file: usize,
        from: usize,
        end: usize,
    ) -> Option<HashMap<String, usize>> {
        let text = self.texts[file];
        if !text.is(from, b'{') || text.find(from + 1, end, b"}") + 1 != end {
            return None;
        }
        // The type may come first: {E6POS: X 1, …}
        let colon = (from + 1..end).find(|at| text.is(*at, b':'));
        let first = colon
            .filter(|at| *at <= from + 2)
            .map_or(from + 1, |at| at + 1);
        let mut out = HashMap::new();
        for (a, b) in text.arguments(first, end - 1) {
            if b >= a + 2 {
                // A component of more than one token is computed, or a list.
                let is_bits = text.is(a + 1, b'\'') && text.is(b - 1, b'\'');
                let at = if b == a + 2 || is_bits {
                    a + 1
                } else {
                    usize::MAX
                };
                out.insert(text.name(a), at);
            }
        }
        Some(out)
    }

    /// Returns a number of bits, and the base in which it is written: `35`, `'B100011'` or `'H23'`.
    fn bits(&self, file: usize, at: usize) -> Option<(Number, u32)> {
        let text = self.texts[file];
        let (number, radix) = if text.is(at, b'\'') {
            let start = text.byte(at + 1);
            let written = start..text.byte(text.find(at + 1, at + 4, b"'"));
            let written = text.source.slice(&written).trim_ascii_end();
            let radix = match written.first()? {
                b'B' | b'b' => 2,
                b'H' | b'h' => 16,
                _ => return None,
            };
            let digits = std::str::from_utf8(&written[1..]).ok()?.trim_start();
            let end = start + written.len();
            let number = Number {
                file: file as u32,
                start: (end - digits.len()) as u32,
                end: end as u32,
                value: u32::from_str_radix(digits, radix).ok()?.into(),
            };
            (number, radix)
        } else {
            (text.number(at)?, 10)
        };
        let is_whole = number.value >= 0.0 && number.value.fract() == 0.0;
        (is_whole && number.value <= MOST_BITS).then_some((number, radix))
    }

    /// Returns the bits of a component, `None` if the point has none; the error says that they cannot be read.
    fn bits_of(
        &self,
        file: usize,
        map: &HashMap<String, usize>,
        name: &str,
    ) -> Result<Option<(Number, u32)>, String> {
        let Some(at) = map.get(name) else {
            return Ok(None);
        };
        let unreadable = || format!("its {} is not a plain number", name.to_ascii_uppercase());
        self.bits(file, *at).map(Some).ok_or_else(unreadable)
    }

    pub(super) fn all_of(
        &self,
        file: usize,
        map: &HashMap<String, usize>,
        names: &[&str],
    ) -> Option<Vec<Number>> {
        let number = |name: &&str| map.get(*name).and_then(|at| self.texts[file].number(*at));
        names.iter().map(number).collect()
    }

    /// Returns the external axes that anything in the files moves from zero, each with the first line that does.
    pub(super) fn external_axes(&self) -> BTreeMap<String, String> {
        let mut out = BTreeMap::new();
        for text in &self.texts {
            let mut depth = 0_usize;
            for at in 0..text.tokens.len() {
                depth += usize::from(text.is(at, b'{'));
                depth = depth.saturating_sub(usize::from(text.is(at, b'}')));
                let name = text.name(at);
                let is_axis = matches!(name.as_bytes(), [b'e', b'1'..=b'6']);
                let behind = |mark: u8| at > 0 && text.is(at - 1, mark);
                let is_component = depth > 0 && (behind(b'{') || behind(b',') || behind(b':'));
                let is_assigned = behind(b'.') && text.is(at + 1, b'=') && !text.is(at + 2, b'=');
                if !is_axis || !(is_component || is_assigned) {
                    continue;
                }
                let value = text.number(at + 1 + usize::from(is_assigned));
                if value.is_none_or(|value| value.value != 0.0) {
                    let location = self.location(text.file, at);
                    let line = self.program.line_of(location);
                    out.entry(name).or_insert(line);
                }
            }
        }
        out
    }

    /// Reads a written point; the error says why it cannot be corrected.
    pub(super) fn point(&self, file: usize, from: usize, end: usize) -> Result<Target, String> {
        let map = self
            .components(file, from, end)
            .ok_or("a part of it is computed")?;
        for (name, at) in &map {
            let is_external = name.len() == 2 && name.starts_with('e');
            let value = self.texts[file].number(*at).map(|n| n.value);
            if is_external && value != Some(0.0) {
                return Err("it has external axes".to_owned());
            }
        }
        let joints: Vec<String> = (1..=6).map(|i| format!("a{i}")).collect();
        let joints: Vec<&str> = joints.iter().map(String::as_str).collect();
        let moving = self.external.iter();
        let mut omitted = moving.filter(|(name, _)| !map.contains_key(*name));
        let (configuration, goal);
        if let Some(n) = self.all_of(file, &map, &joints) {
            (configuration, goal) = (None, Goal::Joints(n));
        } else if let Some(n) = self.all_of(file, &map, &["x", "y", "z", "a", "b", "c"]) {
            // Where an external axis has moved the arm, the same numbers are another place.
            if let Some((name, line)) = omitted.next() {
                let name = name.to_ascii_uppercase();
                return Err(format!(
                    "{name} is missing, so the controller keeps the previous value, which {line} sets"
                ));
            }
            goal = Goal::pose(&n);
            let turn = self.bits_of(file, &map, "t")?;
            let status = self.bits_of(file, &map, "s")?;
            configuration = Some(configured(turn, status.map(|(status, _)| status)));
        } else {
            let is_axes = joints.iter().any(|name| map.contains_key(*name));
            let pose = ["x", "y", "z", "a", "b", "c"];
            let needed = if is_axes { &joints[..] } else { &pose };
            return Err(self.not_whole(file, &map, needed));
        }
        Ok(Target::new(self.location(file, from), goal, configuration))
    }

    /// Returns the reason why a point without all of these numbers is left.
    fn not_whole(&self, file: usize, map: &HashMap<String, usize>, needed: &[&str]) -> String {
        let named = |all: Vec<&str>| all.join(", ").to_ascii_uppercase();
        let is_missing = |name: &&str| !map.contains_key(*name);
        let missing: Vec<&str> = needed.iter().copied().filter(is_missing).collect();
        match missing.len() {
            0 => {
                let is_number = |name: &str| self.texts[file].number(map[name]).is_some();
                let other = needed.iter().copied().find(|name| !is_number(name));
                let other = other.unwrap_or_default().to_ascii_uppercase();
                format!("{other} is not a plain number")
            }
            1 => format!(
                "{} is missing, so the controller keeps the previous value",
                named(missing)
            ),
            _ => format!(
                "{} are missing, so the controller keeps the previous values",
                named(missing)
            ),
        }
    }
}

/// Returns the configuration from the turn bits of a point, which are the signs of the joints, and from its status, which has
/// the sides. Without them the controller keeps those of the point before.
fn configured(turn: Option<(Number, u32)>, status: Option<Number>) -> Configuration {
    let mut out = Configuration::monitored(Vec::new());
    if let Some((number, radix)) = turn {
        let bits = number.value as u32;
        let bound = |joint: usize| of_sign(joint, bits >> joint & 1 == 1);
        out.bounds = (0..6).map(bound).collect();
        let says = Says::Signs { radix };
        out.stated.push(Stated { number, says });
    }
    out.posture = status.map(|status| Posture {
        convention: Convention::Status,
        bits: status.value as u32,
        is_certain: true,
    });
    out
}
