//! The parts of the runtime on which an evaluation spends its instructions, from a recording of a device and the debug
//! information of its image.
//!
//! Most of the runtime is inlined into two functions, so symbols alone say little. For every address, `addr2line` returns
//! the chain of functions that were inlined at it; the innermost function that `RULES` contain determines the part. Code
//! that no rule covers, such as a product of rotations, counts for the part that uses it, and a called function counts for
//! the part of its caller. A new file of the runtime needs only a line in `RULES`; without one it is shown under its name.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io;
use std::path::Path;
use std::process::Command;

use crate::image::{Image, ImageError};

const PROGRAM: &str = "arm-none-eabi-addr2line";

/// Rules: name of the part, end of the file's path, substring of the function's name. The first rule that matches applies.
const RULES: [(&str, &str, &str); 34] = [
    ("sines and cosines", "math/scalar.rs", "sin_cos"),
    (
        "sines and cosines, turned by small changes",
        "elastic/deflection.rs",
        "deflected_into",
    ),
    ("ripple and curves", "elastic/ripple.rs", ""),
    ("ripple and curves", "elastic/curve.rs", ""),
    ("loops over points", "cortex_m4/instructions.rs", ""),
    ("kernels and outputs", "gp/joint_processes.rs", ""),
    ("kernels and outputs", "gp/inducing_sets.rs", ""),
    ("kernels and outputs", "gp/joint_kernel.rs", ""),
    ("kernels and outputs", "gp/loops/mod.rs", ""),
    ("kernels and outputs", "gp/loops/in_assembly.rs", ""),
    ("kernels and outputs", "gp/quadratic_posterior.rs", ""),
    ("kernels and outputs", "gp/quadratic_kernel.rs", ""),
    ("kernels and outputs", "assembly/mod.rs", ""),
    ("kernels and outputs", "cortex_m4/folded.rs", ""),
    ("kernels and outputs", "cortex_m4/inducing_sets.rs", ""),
    ("gravity", "elastic/gravity.rs", ""),
    ("standard deviation", "elastic/position_variance.rs", ""),
    ("standard deviation", "model/position_variance.rs", ""),
    ("chains", "kinematics/poe.rs", ""),
    ("chains", "kinematics/minimal_chain.rs", ""),
    ("coupling", "kinematics/coupling.rs", ""),
    ("Newton steps", "kinematics/newton.rs", ""),
    ("limited step", "correct/step_limit.rs", ""),
    ("search for the command", "correct/mod.rs", ""),
    ("search for the command", "correct/acceptance.rs", ""),
    ("trust and ranges", "guard/trust.rs", ""),
    ("limit, corrected pose", "guard/limit.rs", ""),
    ("limit, corrected pose", "math/se3.rs", "corrected"),
    ("elastic correction, the rest", "elastic/deflection.rs", ""),
    ("elastic correction, the rest", "model/elastic.rs", ""),
    ("checks of the input, status", "model/mod.rs", ""),
    ("checks of the input, status", "model/evaluate.rs", ""),
    ("checks of the input, status", "model/arm.rs", ""),
    ("checks of the input, status", "model/task_space.rs", ""),
];

/// Part of the functions of the compiler's library that copy and clear memory.
const COPYING: &str = "copying and clearing";
const LIBRARY: [&str; 3] = ["memcpy", "memset", "memclr"];
const INTERRUPTS: &str = "interrupts";

/// Number of instructions of each part.
#[derive(Clone, Debug, Default)]
pub struct Parts {
    /// Parts with their number of instructions, in the order of their first occurrence.
    pub counts: Vec<(String, usize)>,
}

/// Why a recording cannot be attributed.
#[derive(Debug, thiserror::Error)]
pub enum PartsError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The program that reads debug information failed.
    #[error("{PROGRAM}: {0}\nhelp: apt-get install binutils-arm-none-eabi")]
    Program(#[from] io::Error),
    /// The function does not occur in the recording.
    #[error("no function that contains {0:?} was executed from its beginning to its end")]
    NotThere(String),
}

impl Parts {
    /// Returns the number of instructions of all parts.
    pub fn whole(&self) -> usize {
        self.counts.iter().map(|(_, count)| count).sum()
    }

    /// Returns the number of instructions of one part; 0 if it does not occur.
    pub fn count(&self, part: &str) -> usize {
        let found = self.counts.iter().find(|(name, _)| name == part);
        found.map_or(0, |(_, count)| *count)
    }

    fn add(&mut self, part: &str) {
        match self.counts.iter_mut().find(|(name, _)| name == part) {
            Some((_, count)) => *count += 1,
            None => self.counts.push((part.to_owned(), 1)),
        }
    }

    /// Counts the instructions of the last execution of the function whose mangled name contains all strings of `function`,
    /// including everything that it calls.
    ///
    /// # Errors
    /// [`PartsError`].
    pub fn of(executed: &[u32], elf: &Path, function: &[&str]) -> Result<Self, PartsError> {
        let image = Image::read(elf)?;
        let missing = || PartsError::NotThere(function.join(" … "));
        let entries: HashSet<u32> = image
            .functions
            .iter()
            .filter(|f| function.iter().all(|part| f.name.contains(part)))
            .map(|f| f.address as u32)
            .collect();
        let begin = executed
            .iter()
            .rposition(|address| entries.contains(address))
            .filter(|begin| *begin > 0)
            .ok_or_else(missing)?;
        let back = executed[begin - 1];
        let length = executed[begin..]
            .iter()
            .position(|address| returns_to(*address, back))
            .ok_or_else(missing)?;
        let executed = &executed[begin..begin + length];
        let places = Places::of(executed, elf)?;
        let starts: HashMap<u32, &str> = image
            .functions
            .iter()
            .map(|f| (f.address as u32, &*f.name))
            .collect();
        let mut parts = Self::default();
        let mut callers: Vec<(u32, String)> = Vec::new();
        let mut current = "the function itself".to_owned();
        let mut before = back;
        for (index, address) in executed.iter().enumerate() {
            if callers
                .last()
                .is_some_and(|(from, _)| returns_to(*address, *from))
            {
                callers.pop();
            } else if let Some(name) = starts.get(address)
                && index > 0
                && !is_next(*address, before)
            {
                let inherited = if LIBRARY.iter().any(|part| name.contains(part)) {
                    COPYING.to_owned()
                } else if name.contains("PendSV") || name.contains("UART") {
                    INTERRUPTS.to_owned()
                } else {
                    current.clone()
                };
                callers.push((before, inherited));
            }
            let inherited = callers.last().map(|(_, part)| part.as_str());
            let part = match inherited {
                Some(part) if part == COPYING || part == INTERRUPTS => part.to_owned(),
                _ => {
                    let known = places.part(*address);
                    known
                        .or(inherited)
                        .unwrap_or("the function itself")
                        .to_owned()
                }
            };
            parts.add(&part);
            current = part;
            before = *address;
        }
        Ok(parts)
    }
}

/// Returns whether `address` follows a call at `from`, which has two or four bytes.
fn returns_to(address: u32, from: u32) -> bool {
    is_next(address, from)
}

fn is_next(address: u32, before: u32) -> bool {
    address == before + 2 || address == before + 4
}

/// The part of every address according to `RULES` alone.
struct Places(HashMap<u32, Option<String>>);

impl Places {
    fn of(executed: &[u32], elf: &Path) -> io::Result<Self> {
        let unique: HashSet<u32> = executed.iter().copied().collect();
        let file = tempfile::NamedTempFile::new()?;
        let list: Vec<String> = unique.iter().map(|a| format!("{a:#x}")).collect();
        fs::write(file.path(), list.join("\n"))?;
        let done = Command::new(PROGRAM)
            .args(["-a", "-i", "-f", "-e"])
            .arg(elf)
            .arg(format!("@{}", file.path().display()))
            .output()?;
        if !done.status.success() {
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            return Err(io::Error::other(said));
        }
        let text = String::from_utf8_lossy(&done.stdout);
        let mut places = HashMap::new();
        let mut lines = text.lines().peekable();
        while let Some(line) = lines.next() {
            let Some(address) = line.strip_prefix("0x") else {
                continue;
            };
            let address = u32::from_str_radix(address, 16).map_err(io::Error::other)?;
            let mut part = None;
            while let Some(name) = lines.next_if(|line| !line.starts_with("0x")) {
                let place = lines.next().unwrap_or("");
                let path = place.split(':').next().unwrap_or("");
                part = part.or_else(|| rule(name, path));
            }
            places.insert(address, part);
        }
        Ok(Self(places))
    }

    fn part(&self, address: u32) -> Option<&str> {
        self.0.get(&address)?.as_deref()
    }
}

/// Utility files of the runtime: their instructions count for the part that uses them.
const SERVING: [&str; 5] = [
    "scalar.rs",
    "se3.rs",
    "kernel.rs",
    "observer.rs",
    "status.rs",
];

fn rule(name: &str, path: &str) -> Option<String> {
    let file = path.split_once("runtime/src/")?.1;
    let known = RULES
        .iter()
        .find(|(_, end, function)| file.ends_with(end) && name.contains(function));
    match known {
        Some((part, _, _)) => Some((*part).to_owned()),
        None if SERVING.contains(&file) => None,
        None => Some(file.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If a file were renamed without its rule, it would be shown under its name, and its part would shrink.
    #[test]
    fn every_rule_names_a_file_of_the_runtime() {
        let runtime = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/src");
        for (part, file, _) in RULES {
            let found = [runtime.clone(), runtime.join("assembly")]
                .iter()
                .any(|folder| folder.join(file).is_file());
            assert!(found, "{part}: no file {file}");
        }
    }
}
