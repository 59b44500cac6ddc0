//! The contents of a device image: the memory that it takes, and the functions that can panic.

use std::fs;
use std::path::Path;

use object::elf::SHF_ALLOC;
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind, SymbolKind};
use poegp_protocol::blob::CRC;

/// First address of RAM; all lower addresses are flash.
const RAM: u64 = 0x2000_0000;

/// A device image.
#[derive(Clone, Debug)]
pub struct Image {
    /// Bytes of flash: vectors, code, constants and initial values.
    pub flash: u64,
    /// Bytes of RAM that are always in use: initialised and zeroed variables, without the stack.
    pub static_ram: u64,
    /// CRC-32C of vectors, code, constants and initial values, as the device computes it from its flash.
    pub crc: u32,
    /// All functions, sorted by address.
    pub functions: Vec<Function>,
}

/// A function of an image.
#[derive(Clone, Debug)]
pub struct Function {
    /// Mangled name.
    pub name: String,
    /// Size in bytes.
    pub size: u64,
    /// Address of its first instruction.
    pub address: u64,
    calls: Vec<u64>,
}

/// Why an image cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read.
    #[error("cannot read the image: {0}")]
    File(#[from] std::io::Error),
    /// The file is not an ELF file.
    #[error("not an ELF file: {0}")]
    Elf(#[from] object::Error),
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// [`ImageError`].
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let bytes = fs::read(path)?;
        let file = object::File::parse(&*bytes)?;
        let (mut flash, mut static_ram) = (0, 0);
        let mut text = (0, &[][..]);
        let mut crc = CRC.digest();
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
                continue;
            };
            if sh_flags.0 & SHF_ALLOC.0 == 0 {
                continue;
            }
            let stored = section.kind() != SectionKind::UninitializedData;
            // Initial values are stored in flash and copied to RAM.
            flash += if stored { section.size() } else { 0 };
            if stored {
                crc.update(section.data()?);
            }
            static_ram += if section.address() >= RAM {
                section.size()
            } else {
                0
            };
            if section.name()? == ".text" {
                text = (section.address(), section.data()?);
            }
        }
        let mut functions = Vec::new();
        for symbol in file.symbols() {
            if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                // Bit 0 marks Thumb code.
                let address = symbol.address() & !1;
                functions.push(Function {
                    name: symbol.name()?.to_owned(),
                    size: symbol.size(),
                    address,
                    calls: calls(text, address, symbol.size()),
                });
            }
        }
        functions.sort_by_key(|function| function.address);
        Ok(Self {
            flash,
            static_ram,
            crc: crc.finalize(),
            functions,
        })
    }

    /// Returns the names of the functions whose name contains one of `parts`.
    pub fn named(&self, parts: &[&str]) -> Vec<&str> {
        let names = self.functions.iter().map(|function| &*function.name);
        names
            .filter(|name| parts.iter().any(|part| name.contains(part)))
            .collect()
    }

    /// Returns the pairs (caller, callee) of direct calls to functions whose name contains `part`.
    pub fn callers(&self, part: &str) -> Vec<(&str, &str)> {
        let mut pairs = Vec::new();
        for callee in self
            .functions
            .iter()
            .filter(|function| function.name.contains(part))
        {
            for caller in &self.functions {
                if caller.calls.contains(&callee.address) {
                    pairs.push((&*caller.name, &*callee.name));
                }
            }
        }
        pairs
    }
}

/// Returns the targets of the BL and B.W instructions (encodings T1 and T4, ARMv7-M ARM A7.7.18 and A7.7.12) in a function.
fn calls((base, text): (u64, &[u8]), address: u64, size: u64) -> Vec<u64> {
    let Some(start) = address.checked_sub(base) else {
        return Vec::new();
    };
    let code = text
        .get(start as usize..(start + size) as usize)
        .unwrap_or(&[]);
    let words: Vec<u16> = code
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    let mut targets = Vec::new();
    for (index, pair) in words.windows(2).enumerate() {
        let (first, second) = (u32::from(pair[0]), u32::from(pair[1]));
        if first & 0xf800 != 0xf000 || second & 0x9000 != 0x9000 {
            continue;
        }
        let sign = first >> 10 & 1;
        let i1 = !(second >> 13 ^ sign) & 1;
        let i2 = !(second >> 11 ^ sign) & 1;
        let offset =
            (sign << 24 | i1 << 23 | i2 << 22 | (first & 0x3ff) << 12 | (second & 0x7ff) << 1)
                as i32;
        let offset = offset << 7 >> 7;
        let from = address + 2 * index as u64 + 4;
        targets.push(from.wrapping_add_signed(i64::from(offset)));
    }
    targets
}
