//! An upper bound on the stack that an image needs, computed from its call graph.
//!
//! Every function of the image is disassembled. Its frame is the sum of everything that it subtracts from the stack pointer;
//! its callees are the targets of its branches. The deepest chain of frames below a root is then a bound that holds for all
//! data: nothing is measured, so no path can be missed.
//!
//! - **Calls by register.** The compiler keeps the address of a function that it calls several times in a register, and
//!   passes closures. Such a call is assumed to reach every function whose address the calling function loads or, if it
//!   loads none, whose address its callers load. Addresses of functions in constants (tables of methods) are rejected.
//! - **Rejected** is everything that would make the sum wrong: recursion, a computed stack pointer, a jump into another
//!   function, a call of an unknown function. The image contains none of these.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

use crate::stack::instruction::{Effect, Instruction};

mod instruction;

const PROGRAM: &str = "arm-none-eabi-objdump";

/// Prefix of the name of the section that contains the exception vectors.
const VECTORS: &str = ".vector";

/// Largest frame that an exception of an ARMv7-M processor with a floating-point unit stores, in bytes: 26 words of four
/// bytes, and one to align the stack (Architecture Reference Manual, B1.5.7).
pub const EXCEPTION_FRAME: u64 = 4 * 27;

/// The call graph of an image.
#[derive(Clone, Debug)]
pub struct CallGraph {
    /// Address of each exception's handler, by the number of the exception: 1 is the reset. Zero if there is no handler.
    pub vectors: Vec<u64>,
    functions: BTreeMap<u64, Node>,
}

#[derive(Clone, Debug, Default)]
struct Node {
    name: String,
    /// Size of the stack frame, in bytes.
    frame: u64,
    calls: BTreeSet<u64>,
    /// Functions whose address this function loads.
    addresses: BTreeSet<u64>,
    calls_by_register: bool,
}

/// The deepest chain of calls below a function.
#[derive(Clone, Debug)]
pub struct Deepest {
    /// Bytes of stack that the whole chain takes.
    pub bytes: u64,
    /// Functions of the chain, outermost first, with the bytes of their frames.
    pub chain: Vec<(String, u64)>,
}

/// Why no bound can be computed.
#[derive(Debug, thiserror::Error)]
pub enum StackError {
    /// The image cannot be read or the disassembler cannot be started.
    #[error("cannot disassemble: {0} (is {PROGRAM} of gcc-arm-none-eabi installed?)")]
    File(#[from] std::io::Error),
    /// The image is not an ELF file.
    #[error("not an ELF file: {0}")]
    Elf(#[from] object::Error),
    /// The disassembler failed.
    #[error("{PROGRAM} failed: {0}")]
    Disassembler(String),
    /// A function computes the stack pointer or has a jump that cannot be followed.
    #[error("{function}: cannot follow `{instruction}`")]
    Instruction {
        /// Name of the function.
        function: String,
        /// The instruction.
        instruction: String,
    },
    /// A function calls by register, but neither it nor its callers load a function's address.
    #[error("{0}: calls by register, and neither it nor a caller loads a function's address")]
    UnknownCallee(String),
    /// A function's address lies in constants: calls through it would not be found.
    #[error("the address of {0} lies in constants")]
    AddressInConstants(String),
    /// The linker kept no relocations, without which an address cannot be distinguished from a number.
    #[error("the file has no relocations (the linker's --emit-relocs)")]
    NoRelocations,
    /// A function that calls itself, directly or not.
    #[error("recursion: {0}")]
    Recursion(String),
    /// No function begins here.
    #[error("no function begins at {0:#x}")]
    Unknown(u64),
}

impl CallGraph {
    /// Disassembles an ELF file.
    ///
    /// # Errors
    /// [`StackError`], except [`StackError::Recursion`] and [`StackError::Unknown`].
    pub fn read(elf: &Path) -> Result<Self, StackError> {
        let mut functions = frames_and_calls(elf)?;
        refuse_addresses_in_constants(elf, &functions)?;
        resolve_calls_by_register(&mut functions)?;
        let vectors = vectors(elf)?;
        Ok(Self { vectors, functions })
    }

    /// Returns the deepest chain of calls below the function that begins at an address.
    ///
    /// # Errors
    /// [`StackError::Recursion`], [`StackError::Unknown`].
    pub fn deepest(&self, address: u64) -> Result<Deepest, StackError> {
        if !self.functions.contains_key(&address) {
            return Err(StackError::Unknown(address));
        }
        let mut known = BTreeMap::new();
        self.visit(address, &mut Vec::new(), &mut known)?;
        let mut chain = Vec::new();
        let mut next = Some(address);
        while let Some(address) = next {
            let node = &self.functions[&address];
            chain.push((node.name.clone(), node.frame));
            next = known[&address].1;
        }
        let bytes = known[&address].0;
        Ok(Deepest { bytes, chain })
    }

    /// Returns the names of all functions that can run when the function at an address is called, including its own name.
    ///
    /// # Errors
    /// [`StackError::Unknown`].
    pub fn reached(&self, address: u64) -> Result<BTreeSet<&str>, StackError> {
        let mut seen = BTreeSet::new();
        let mut open = vec![address];
        while let Some(next) = open.pop() {
            let node = self.functions.get(&next);
            let node = node.ok_or(StackError::Unknown(next))?;
            if seen.insert(next) {
                open.extend(&node.calls);
            }
        }
        let names = seen.iter().map(|one| &*self.functions[one].name);
        Ok(names.collect())
    }

    /// Enters into `known` the bytes of the deepest chain that begins with a function, including its own frame, and its
    /// deepest callee.
    fn visit(
        &self,
        address: u64,
        open: &mut Vec<u64>,
        known: &mut BTreeMap<u64, (u64, Option<u64>)>,
    ) -> Result<u64, StackError> {
        if let Some(&(bytes, _)) = known.get(&address) {
            return Ok(bytes);
        }
        if let Some(start) = open.iter().position(|&other| other == address) {
            let names = open[start..].iter().map(|one| &*self.functions[one].name);
            return Err(StackError::Recursion(names.collect::<Vec<_>>().join(" > ")));
        }
        open.push(address);
        let node = &self.functions[&address];
        let mut deepest = (0, None);
        for &callee in &node.calls {
            let bytes = self.visit(callee, open, known)?;
            if bytes > deepest.0 {
                deepest = (bytes, Some(callee));
            }
        }
        open.pop();
        let bytes = deepest.0 + node.frame;
        known.insert(address, (bytes, deepest.1));
        Ok(bytes)
    }
}

fn frames_and_calls(elf: &Path) -> Result<BTreeMap<u64, Node>, StackError> {
    let ends = ends_of_functions(elf)?;
    let mut functions: BTreeMap<u64, Node> = BTreeMap::new();
    let mut targets: Vec<(u64, u64, String)> = Vec::new();
    let mut here = None;
    // Bytes saved around a call of outlined code and restored at once: the largest value counts, not the sum.
    let mut saved: BTreeMap<u64, u64> = BTreeMap::new();
    // Lower halves of addresses that are loaded in two halves, by register.
    let mut halves: BTreeMap<String, u64> = BTreeMap::new();
    for line in disassembly(elf)?.lines() {
        if let Some((address, name)) = heading(line) {
            here = ends.contains_key(&address).then_some(address);
            halves.clear();
            if here.is_some() {
                let name = name.to_owned();
                functions.entry(address).or_default().name = name;
            }
            continue;
        }
        let (Some(start), Some(instruction)) = (here, Instruction::parse(line)) else {
            continue;
        };
        // Between the end of a function and the next function there is only padding.
        if instruction.address >= ends[&start] {
            continue;
        }
        let inside = start..ends[&start];
        let node = functions.entry(start).or_default();
        match instruction.effect() {
            Effect::None => {}
            Effect::Takes(bytes) => node.frame += bytes,
            Effect::Saves(bytes) => {
                let largest = saved.entry(start).or_default();
                *largest = bytes.max(*largest);
            }
            Effect::Branch(target) if inside.contains(&target) && !instruction.is_call() => {}
            Effect::Branch(target) => targets.push((start, target, instruction.to_string())),
            Effect::CallByRegister => node.calls_by_register = true,
            Effect::LowerHalf(register, half) => {
                halves.insert(register, half);
            }
            Effect::UpperHalf(register, half) => {
                let lower = halves.get(&register).copied().unwrap_or(0);
                node.addresses.insert(half << 16 | lower);
            }
            Effect::Word(word) => {
                node.addresses.insert(word);
            }
            Effect::Unknown => {
                return Err(StackError::Instruction {
                    function: node.name.clone(),
                    instruction: instruction.to_string(),
                });
            }
        }
    }
    for (start, bytes) in saved {
        functions.entry(start).or_default().frame += bytes;
    }
    for (start, target, instruction) in targets {
        let known = functions.contains_key(&target);
        let node = functions.entry(start).or_default();
        if !known {
            let function = node.name.clone();
            return Err(StackError::Instruction {
                function,
                instruction,
            });
        }
        node.calls.insert(target);
    }
    // Bit 0 marks Thumb code.
    let starts: BTreeSet<u64> = functions.keys().copied().collect();
    for node in functions.values_mut() {
        let odd = node.addresses.iter().filter(|word| *word & 1 == 1);
        let addresses = odd.map(|word| word & !1);
        node.addresses = addresses.filter(|word| starts.contains(word)).collect();
    }
    Ok(functions)
}

/// Parses the heading of a function in a disassembly, its start and name: `00000400 <Reset>:`.
fn heading(line: &str) -> Option<(u64, &str)> {
    let (address, name) = line.strip_suffix(">:")?.split_once(" <")?;
    Some((u64::from_str_radix(address, 16).ok()?, name))
}

fn disassembly(elf: &Path) -> Result<String, StackError> {
    let arguments = ["--disassemble", "--demangle", "--no-show-raw-insn"];
    let output = Command::new(PROGRAM).args(arguments).arg(elf).output()?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        return Err(StackError::Disassembler(text.into_owned()));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Returns the end of every function by its start.
fn ends_of_functions(elf: &Path) -> Result<BTreeMap<u64, u64>, StackError> {
    let bytes = fs::read(elf)?;
    let file = object::File::parse(&*bytes)?;
    let mut ends = BTreeMap::new();
    for symbol in file.symbols() {
        if symbol.kind() == SymbolKind::Text {
            let start = symbol.address() & !1;
            let end = ends.entry(start).or_insert(start);
            *end = (start + symbol.size()).max(*end);
        }
    }
    // A symbol without a size ends where the next symbol begins.
    let starts: Vec<u64> = ends.keys().copied().collect();
    for (start, end) in &mut ends {
        if end == start {
            let next = starts.iter().find(|other| *other > start);
            *end = next.copied().unwrap_or(u64::MAX);
        }
    }
    Ok(ends)
}

/// Returns the vector table at the beginning of the flash; its first entry, the initial stack pointer, becomes 0.
fn vectors(elf: &Path) -> Result<Vec<u64>, StackError> {
    let bytes = fs::read(elf)?;
    let file = object::File::parse(&*bytes)?;
    let mut table = Vec::new();
    for section in file.sections() {
        if section.name()?.starts_with(VECTORS) {
            table.extend(words(section.data()?).map(|word| word & !1));
        }
    }
    if let Some(first) = table.first_mut() {
        *first = 0;
    }
    Ok(table)
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u64> {
    bytes
        .chunks_exact(4)
        .map(|word| u64::from(u32::from_le_bytes([word[0], word[1], word[2], word[3]])))
}

/// Rejects functions' addresses in constants. Only relocated values count, because a number may look like an address.
fn refuse_addresses_in_constants(
    elf: &Path,
    functions: &BTreeMap<u64, Node>,
) -> Result<(), StackError> {
    let bytes = fs::read(elf)?;
    let file = object::File::parse(&*bytes)?;
    let constants = [SectionKind::ReadOnlyData, SectionKind::Data];
    let mut vectors_are_relocated = false;
    for section in file.sections() {
        let relocated = section.relocations().map(|(address, _)| address);
        // The vectors are the roots of the call graph: the hardware calls them.
        if section.name()?.starts_with(VECTORS) {
            vectors_are_relocated |= relocated.count() > 0;
            continue;
        }
        if !constants.contains(&section.kind()) {
            continue;
        }
        let data = section.data()?;
        for address in relocated {
            let start = address.checked_sub(section.address());
            let tail = start.and_then(|start| data.get(usize::try_from(start).ok()?..));
            let word = tail.and_then(|tail| words(tail).next());
            let word = word.ok_or(StackError::Unknown(address))?;
            if let Some(node) = functions.get(&(word & !1)).filter(|_| word & 1 == 1) {
                return Err(StackError::AddressInConstants(node.name.clone()));
            }
        }
    }
    if !vectors_are_relocated {
        return Err(StackError::NoRelocations);
    }
    Ok(())
}

fn resolve_calls_by_register(functions: &mut BTreeMap<u64, Node>) -> Result<(), StackError> {
    // Outlined code, which several functions share, jumps to the address in a register of its caller.
    let shared = |node: &Node| node.name.starts_with("OUTLINED_FUNCTION");
    let jumps: BTreeSet<u64> = functions
        .iter()
        .filter(|(_, node)| shared(node) && node.calls_by_register)
        .map(|(&address, _)| address)
        .collect();
    let mut found: Vec<(u64, BTreeSet<u64>)> = Vec::new();
    for (&address, node) in functions.iter().filter(|(_, node)| !shared(node)) {
        if !node.calls_by_register && node.calls.is_disjoint(&jumps) {
            continue;
        }
        let mut callees = node.addresses.clone();
        if callees.is_empty() {
            let callers = functions.values();
            for caller in callers.filter(|caller| caller.calls.contains(&address)) {
                callees.extend(&caller.addresses);
            }
        }
        if callees.is_empty() {
            return Err(StackError::UnknownCallee(node.name.clone()));
        }
        found.push((address, callees));
    }
    for (address, callees) in found {
        functions.entry(address).or_default().calls.extend(callees);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A function of a test graph: address, frame, calls, loaded addresses, and whether it calls by register.
    type Function<'a> = (u64, u64, &'a [u64], &'a [u64], bool);

    /// Creates a call graph whose functions are named by their address.
    fn graph(nodes: &[Function]) -> Result<CallGraph, StackError> {
        let mut functions = BTreeMap::new();
        for &(address, frame, calls, addresses, calls_by_register) in nodes {
            let node = Node {
                name: address.to_string(),
                frame,
                calls: calls.iter().copied().collect(),
                addresses: addresses.iter().copied().collect(),
                calls_by_register,
            };
            functions.insert(address, node);
        }
        resolve_calls_by_register(&mut functions)?;
        Ok(CallGraph {
            vectors: Vec::new(),
            functions,
        })
    }

    #[test]
    fn the_deepest_chain_counts_not_the_longest() {
        let nodes: [Function; 4] = [
            (2, 8, &[4, 8], &[], false),
            (4, 8, &[6], &[], false),
            (6, 8, &[], &[], false),
            (8, 100, &[], &[], false),
        ];
        let deepest = graph(&nodes).unwrap().deepest(2).unwrap();
        assert_eq!(deepest.bytes, 108);
        assert_eq!(deepest.chain, [("2".to_owned(), 8), ("8".to_owned(), 100)]);
    }

    /// The calling function or its caller loads the address in the register.
    #[test]
    fn calls_by_register_are_followed() {
        let nodes: [Function; 3] = [
            (2, 8, &[4], &[6], false),
            (4, 8, &[], &[], true),
            (6, 32, &[], &[], false),
        ];
        assert_eq!(graph(&nodes).unwrap().deepest(2).unwrap().bytes, 48);
        assert_eq!(graph(&nodes).unwrap().reached(4).unwrap().len(), 2);
        let unknown = graph(&nodes[1..]).unwrap_err();
        assert!(matches!(unknown, StackError::UnknownCallee(name) if name == "4"));
    }

    #[test]
    fn recursion_is_refused() {
        let nodes: [Function; 3] = [
            (2, 8, &[4], &[], false),
            (4, 8, &[6], &[], false),
            (6, 8, &[4], &[], false),
        ];
        let error = graph(&nodes).unwrap().deepest(2).unwrap_err();
        assert_eq!(error.to_string(), "recursion: 4 > 6");
        assert_eq!(graph(&nodes).unwrap().reached(2).unwrap().len(), 3);
    }
}
