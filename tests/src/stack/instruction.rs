//! The effect of an instruction on the stack and its branch target, parsed from the output of `objdump`.

use std::fmt;

/// A line of a disassembly.
#[derive(Clone, Debug)]
pub struct Instruction<'a> {
    pub address: u64,
    /// Mnemonic without a width suffix: `sub` for `sub.w`. Directives for data begin with a dot.
    name: &'a str,
    operands: &'a str,
}

/// The effect of an instruction on the stack bound.
#[derive(Clone, Debug, Eq, PartialEq)]
pub enum Effect {
    /// The instruction has no effect.
    None,
    /// Takes the given number of bytes of stack.
    Takes(u64),
    /// Takes the given number of bytes of stack for one call only.
    Saves(u64),
    /// Branches to an address.
    Branch(u64),
    /// Branches to the address in a register.
    CallByRegister,
    /// Loads the lower half of a register with a constant.
    LowerHalf(String, u64),
    /// Loads the upper half of a register with a constant.
    UpperHalf(String, u64),
    /// A constant of four bytes within the code.
    Word(u64),
    /// Changes the stack pointer or jumps in a way that cannot be followed.
    Unknown,
}

/// Instructions that release stack or only read it.
const GIVES: [&str; 8] = [
    "add", "addw", "pop", "ldmia", "vldmia", "vpop", "ldr", "ldrd",
];

impl<'a> Instruction<'a> {
    /// Parses a line such as `    4704:\tldr.w\tr0, [r1, #44]\t@ 0x2c`.
    pub fn parse(line: &'a str) -> Option<Self> {
        let (address, rest) = line.split_once(":\t")?;
        let address = u64::from_str_radix(address.trim(), 16).ok()?;
        let (name, operands) = rest.split_once('\t').unwrap_or((rest, ""));
        let name = if name.starts_with('.') {
            name
        } else {
            name.split('.').next().unwrap_or(name)
        };
        let operands = operands.split(['@', ';']).next().unwrap_or("").trim();
        Some(Self {
            address,
            name: name.trim(),
            operands,
        })
    }

    pub fn is_call(&self) -> bool {
        matches!(self.name, "bl" | "blx")
    }

    pub fn effect(&self) -> Effect {
        let (first, rest) = self
            .operands
            .split_once(", ")
            .unwrap_or((self.operands, ""));
        match self.name {
            ".word" => number(self.operands).map_or(Effect::None, Effect::Word),
            "push" | "vpush" => registers(self.operands).map_or(Effect::Unknown, Effect::Takes),
            "stmdb" | "vstmdb" if first == "sp!" => {
                registers(rest).map_or(Effect::Unknown, Effect::Takes)
            }
            "sub" | "subw" if first == "sp" => {
                let bytes = rest.strip_prefix("sp, ").unwrap_or(rest);
                number(bytes).map_or(Effect::Unknown, Effect::Takes)
            }
            "movw" => self.half(first, rest, Effect::LowerHalf),
            "movt" => self.half(first, rest, Effect::UpperHalf),
            "blx" | "bx" if first == "lr" && self.name == "bx" => Effect::None,
            "blx" | "bx" => Effect::CallByRegister,
            _ if self.is_branch() => self.target(),
            _ if self.operands.contains("[sp, #-") && self.operands.ends_with("]!") => {
                let bytes = self.operands.split("[sp, #-").nth(1);
                let bytes = bytes.and_then(|rest| rest.trim_end_matches("]!").parse().ok());
                bytes.map_or(Effect::Unknown, Effect::Saves)
            }
            _ if self.moves_stack_pointer(first) => Effect::Unknown,
            "ldr" if self.operands.starts_with("pc, [sp], #") => Effect::None,
            _ if first == "pc" && self.name != "tbb" && self.name != "tbh" => Effect::Unknown,
            _ => Effect::None,
        }
    }

    /// Returns whether the instruction writes the stack pointer in another way than by releasing a constant number of bytes.
    fn moves_stack_pointer(&self, first: &str) -> bool {
        // An instruction with a list of registers changes the stack pointer only if it says so with `!`.
        let several = self.operands.ends_with('}') && first == "sp";
        let writes =
            first == "sp" && !several || first == "sp!" || self.operands.contains("[sp], #");
        let compares = matches!(self.name, "cmp" | "cmn" | "tst");
        let gives = GIVES.iter().any(|name| self.name.starts_with(name))
            && (first != "sp" || number(self.operands.rsplit(", ").next().unwrap_or("")).is_some());
        let special = self.name == "msr" && (first == "MSP" || first == "PSP");
        special || writes && !compares && !gives
    }

    fn is_branch(&self) -> bool {
        let name = self.name.strip_prefix('b');
        let conditions = [
            "", "l", "eq", "ne", "cs", "cc", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt",
            "le",
        ];
        name.is_some_and(|rest| conditions.contains(&rest)) || matches!(self.name, "cbz" | "cbnz")
    }

    /// Parses the branch target, which is the last operand: `4704 <name+0x28>`.
    fn target(&self) -> Effect {
        let operands = self
            .operands
            .split_once(" <")
            .map_or(self.operands, |(one, _)| one);
        let address = operands.rsplit(", ").next().unwrap_or("");
        u64::from_str_radix(address, 16).map_or(Effect::Unknown, Effect::Branch)
    }

    fn half(&self, register: &str, value: &str, effect: fn(String, u64) -> Effect) -> Effect {
        number(value).map_or(Effect::None, |value| effect(register.to_owned(), value))
    }
}

impl fmt::Display for Instruction<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:x}: {} {}", self.address, self.name, self.operands)
    }
}

/// Parses a number such as `#12` or `0x0c`.
fn number(text: &str) -> Option<u64> {
    if let Some(digits) = text.strip_prefix("0x") {
        return u64::from_str_radix(digits, 16).ok();
    }
    text.strip_prefix('#')?.parse().ok()
}

/// Returns the number of bytes of a list of registers such as `{r4, r7, lr}`, `{d8-d11}` or `{s16}`.
fn registers(list: &str) -> Option<u64> {
    let list = list.strip_prefix('{')?.strip_suffix('}')?;
    let mut bytes = 0;
    for one in list.split(',').map(str::trim) {
        let width = if one.starts_with('d') { 8 } else { 4 };
        let count = match one.split_once('-') {
            Some((first, last)) => {
                let index =
                    |name: &str| name.get(1..).and_then(|digits| digits.parse::<u64>().ok());
                index(last)?.checked_sub(index(first)?)? + 1
            }
            None => 1,
        };
        bytes += width * count;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effect(text: &str) -> Effect {
        Instruction::parse(&format!("    4704:\t{text}"))
            .unwrap()
            .effect()
    }

    #[test]
    fn what_takes_stack() {
        for (text, bytes) in [
            ("push\t{r4, r5, r6, r7, lr}", 20),
            ("stmdb\tsp!, {r5, r6, r7, r8, r9, sl, fp}", 28),
            ("vpush\t{d8-d11}", 32),
            ("vpush\t{s16-s18}", 12),
            ("vstmdb\tsp!, {d8}", 8),
            ("sub\tsp, #164\t@ 0xa4", 164),
            ("sub.w\tsp, sp, #1040\t@ 0x410", 1_040),
            ("subw\tsp, sp, #4040\t@ 0xfc8", 4_040),
        ] {
            assert_eq!(effect(text), Effect::Takes(bytes), "{text}");
        }
        assert_eq!(effect("str.w\tlr, [sp, #-8]!"), Effect::Saves(8));
        assert_eq!(effect("strd\tr0, r1, [sp, #-16]!"), Effect::Saves(16));
    }

    #[test]
    fn what_gives_it_back_or_leaves_it() {
        for text in [
            "add\tsp, #164\t@ 0xa4",
            "addw\tsp, sp, #4040",
            "pop\t{r4, r5, r6, r7, pc}",
            "ldmia.w\tsp!, {r8, r9, sl, fp}",
            "vpop\t{d8-d11}",
            "ldr.w\tr8, [sp], #4",
            "ldr\tr0, [sp, #4]",
            "str\tr0, [sp, #4]",
            "add\tr0, sp, #12",
            "mov\tr7, sp",
            "bx\tlr",
            "ldr.w\tpc, [sp], #4",
            "tbb\t[pc, r2]",
            "bfi\tr0, r1, #3, #2",
            "bics\tr0, r1",
            "stmia.w\tsp, {r0, r1, r2, r5}",
        ] {
            assert_eq!(effect(text), Effect::None, "{text}");
        }
    }

    #[test]
    fn what_cannot_be_followed() {
        for text in [
            "sub.w\tsp, sp, r4",
            "mov\tsp, r4",
            "add\tsp, r4",
            "bic.w\tsp, sp, #7",
            "msr\tMSP, r0",
            "ldr.w\tpc, [r0, r1, lsl #2]",
            "mov\tpc, r3",
        ] {
            assert_eq!(effect(text), Effect::Unknown, "{text}");
        }
    }

    #[test]
    fn where_it_goes() {
        assert_eq!(
            effect("bl\t1d80c <OUTLINED_FUNCTION_11>"),
            Effect::Branch(0x1d80c)
        );
        assert_eq!(effect("bne.n\t4704 <f+0x28>"), Effect::Branch(0x4704));
        assert_eq!(effect("cbz\tr1, 473c <f+0x60>"), Effect::Branch(0x473c));
        assert_eq!(effect("blx\tr8"), Effect::CallByRegister);
        assert_eq!(effect("bx\tr3"), Effect::CallByRegister);
        assert_eq!(effect(".word\t0x00008817"), Effect::Word(0x8817));
        let half = ("r8".to_owned(), 0xc0a9);
        assert_eq!(
            effect("movw\tr8, #49321\t@ 0xc0a9"),
            Effect::LowerHalf(half.0, half.1)
        );
    }
}
