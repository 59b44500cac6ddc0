//! Data that VAL3 programs change: by assignments, by instructions, and by programs to which they give them.

use std::collections::{HashMap, HashSet};

use crate::robot_programs::correction::program::Location;
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::tokens::{Kind, Text};
use crate::robot_programs::correction::val3::Reader;
use crate::robot_programs::correction::val3::tags::tags;

/// Instructions and functions that get points, tools or frames, and leave them as they are.
const READING: &[&str] = &[
    "movej",
    "movel",
    "movec",
    "abs",
    "align",
    "appro",
    "close",
    "compose",
    "config",
    "distance",
    "here",
    "herej",
    "interpolatec",
    "interpolatel",
    "isdefined",
    "isinrange",
    "jointtopoint",
    "max",
    "min",
    "open",
    "popupmsg",
    "position",
    "put",
    "putln",
    "resetmotion",
    "sel",
    "size",
    "tostring",
    "trsf",
    "userpage",
    "waitendmove",
];

/// Words after which a bracket encloses an expression.
const KEYWORDS: &[&str] = &[
    "and", "case", "do", "else", "elseif", "for", "if", "not", "or", "return", "step", "switch",
    "to", "until", "while", "xor",
];

/// Data that a program changes, by the token of their name.
#[derive(Clone, Copy)]
struct Changed {
    from: usize,
    /// Whether all elements may change.
    is_whole: bool,
}

/// A parameter of a program.
struct Parameter {
    name: String,
    /// Whether it stands for the data of the caller, and not for their value.
    is_reference: bool,
    is_array: bool,
}

/// An argument that a program gives to a parameter of another one.
struct Given {
    /// Index of the text with the call.
    text: usize,
    changed: Changed,
    /// Index of the text with the program, and of the parameter.
    to: (usize, usize),
}

impl Reader<'_> {
    /// Notes the data that programs change: `fPart.trsf=…`, `pPoint[1].trsf.z=…`, `tGun=…`, `setFrame(…,fPart)`, `link(p,f)`,
    /// and what they give to programs and instructions that change it.
    pub(super) fn changes(&mut self, texts: &[Text<'_>]) {
        let parameters: Vec<Vec<Parameter>> = texts.iter().map(|t| parameters(t.source)).collect();
        let mut programs: HashMap<String, usize> = HashMap::new();
        for (index, text) in texts.iter().enumerate() {
            let stem = text.source.path.file_stem().unwrap_or_default();
            programs
                .entry(stem.to_string_lossy().into_owned())
                .or_insert(index);
        }
        let mut given = Vec::new();
        let mut open = Vec::new();
        let mut all: Vec<Vec<Changed>> = Vec::new();
        for (index, text) in texts.iter().enumerate() {
            let mut changed = assigned(text);
            for at in 0..text.tokens.len() {
                let is_name = text.at(at).is_some_and(|t| t.kind == Kind::Name);
                if !is_name || !text.is(at + 1, b'(') {
                    continue;
                }
                let is_of_library = at > 0 && text.is(at - 1, b':');
                let program = programs.get(&text.spelling(at)).filter(|_| !is_of_library);
                match program.copied() {
                    Some(program) => {
                        for (number, found) in arguments(text, at).into_iter().enumerate() {
                            let to = (program, number);
                            let Some(parameter) = parameters[program].get(number) else {
                                changed.extend(found);
                                continue;
                            };
                            if let Some(found) = found.filter(|_| parameter.is_reference) {
                                let is_whole = found.is_whole || parameter.is_array;
                                let changed = Changed { is_whole, ..found };
                                given.push(Given {
                                    text: index,
                                    changed,
                                    to,
                                });
                            }
                        }
                    }
                    None => changed.extend(by_instruction(text, at)),
                }
            }
            let names: HashSet<String> = changed.iter().map(|c| text.spelling(c.from)).collect();
            let own = parameters[index].iter().enumerate();
            let own = own.filter(|(_, parameter)| names.contains(&parameter.name));
            open.extend(own.map(|(number, _)| (index, number)));
            all.push(changed);
        }
        // What is given to a parameter that its program changes is changed, and may be a parameter itself.
        let mut by_parameter: HashMap<(usize, usize), Vec<Given>> = HashMap::new();
        for given in given {
            by_parameter.entry(given.to).or_default().push(given);
        }
        while let Some(parameter) = open.pop() {
            for given in by_parameter.remove(&parameter).unwrap_or_default() {
                let name = texts[given.text].spelling(given.changed.from);
                let own = parameters[given.text].iter().position(|p| p.name == name);
                open.extend(own.map(|number| (given.text, number)));
                all[given.text].push(given.changed);
            }
        }
        for (text, changed) in texts.iter().zip(all) {
            for changed in changed {
                self.change(text, changed);
            }
        }
    }

    /// Notes that a program changes data.
    fn change(&mut self, text: &Text<'_>, Changed { from, is_whole }: Changed) {
        let behind = match text.is(from + 1, b'[') {
            true => text.find(from + 2, text.tokens.len(), b"]") + 1,
            false => from + 1,
        };
        let element = Self::element(text, (from, behind)).filter(|_| !is_whole);
        let name = element.unwrap_or_else(|| text.spelling(from));
        let location = Location {
            file: text.file,
            at: text.byte(from),
        };
        let line = self.program.line_of(location);
        if let Some((Some(target), _)) = self.named.get(&name) {
            let location = self.program.targets[*target].location;
            let reason = format!("the program changes it at {line}");
            self.program.leave(location, reason);
        }
        let all = format!("{name}[");
        for (key, (target, _)) in &self.named {
            if let Some(target) = target.filter(|_| key.starts_with(&all)) {
                let location = self.program.targets[target].location;
                let reason = format!("the program changes one of {name} at {line}");
                self.program.leave(location, reason);
            }
        }
        self.changed.entry(name).or_insert(line);
    }
}

/// Returns the parameters of the program in a file.
fn parameters(source: &Source) -> Vec<Parameter> {
    let all = tags(source).into_iter();
    let parameter = all.filter(|tag| tag.name == "Parameter").map(|tag| {
        let is = |key: &str, expected: &str| tag.value(source, key).is_some_and(|v| v == expected);
        let is_element = is("xsi:type", "element");
        Parameter {
            name: tag.value(source, "name").unwrap_or_default(),
            // Arrays have no values of their own.
            is_reference: !is_element || is("use", "reference"),
            is_array: !is_element,
        }
    });
    parameter.collect()
}

/// Returns the arguments of a call, `None` for those that are no data.
fn arguments(text: &Text<'_>, at: usize) -> Vec<Option<Changed>> {
    let end = text.find(at + 2, text.tokens.len(), b")");
    let all = text.arguments(at + 2, end).into_iter();
    all.map(|(from, end)| {
        let is_name = text.at(from).is_some_and(|t| t.kind == Kind::Name);
        let mut at = from + 1;
        while at < end {
            at = match (text.is(at, b'['), text.is(at, b'.')) {
                (true, _) => text.find(at + 1, end, b"]") + 1,
                (_, true) => at + 2,
                _ => return None,
            };
        }
        let changed = Changed {
            from,
            is_whole: false,
        };
        is_name.then_some(changed)
    })
    .collect()
}

/// Returns the data that an instruction or function may change, or a program that is in none of the files.
fn by_instruction(text: &Text<'_>, at: usize) -> Vec<Changed> {
    let name = text.name(at);
    if READING.contains(&name.as_str()) || KEYWORDS.contains(&name.as_str()) {
        return Vec::new();
    }
    let all = arguments(text, at);
    match name.as_str() {
        "setframe" | "pointtojoint" => all.last().copied().flatten().into_iter().collect(),
        "link" => all.first().copied().flatten().into_iter().collect(),
        _ => {
            let whole = |found: Changed| Changed {
                // insert(pPoint,2) moves the other elements.
                is_whole: !text.is(found.from + 1, b'.'),
                ..found
            };
            all.into_iter().flatten().map(whole).collect()
        }
    }
}

/// Returns the data on the left sides of assignments.
fn assigned(text: &Text<'_>) -> Vec<Changed> {
    let mut out = Vec::new();
    for at in 1..text.tokens.len() {
        let is_compared = text.is(at + 1, b'=')
            || [b'=', b'!', b'<', b'>']
                .iter()
                .any(|mark| text.is(at - 1, *mark));
        if !text.is(at, b'=') || is_compared {
            continue;
        }
        // The name stands before its key and its components.
        let (mut from, mut depth) = (at, 0_usize);
        while from > 0 {
            from -= 1;
            depth += usize::from(text.is(from, b']'));
            depth = depth.saturating_sub(usize::from(text.is(from, b'[')));
            let is_component = from > 0 && text.is(from - 1, b'.');
            let is_name = text.at(from).is_some_and(|t| t.kind == Kind::Name);
            if depth == 0 && is_name && !is_component {
                break;
            }
        }
        out.push(Changed {
            from,
            is_whole: false,
        });
    }
    out
}
