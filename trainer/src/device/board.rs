//! The boards that QEMU can emulate.

use clap::ValueEnum;

/// A board that can be emulated. Its name is the firmware's Cargo feature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Board {
    /// Cortex-M4F.
    #[default]
    #[value(name = "mps2-an386")]
    Mps2An386,
    /// Cortex-M7.
    #[value(name = "mps2-an500")]
    Mps2An500,
    /// Cortex-M55 with Helium.
    #[value(name = "mps3-an547")]
    Mps3An547,
    /// Cortex-M4F, QEMU's netduinoplus2: without its clocks and its flash controller.
    #[value(name = "stm32f405")]
    Stm32F405,
}

impl Board {
    /// All boards.
    pub const ALL: [Self; 4] = [
        Self::Mps2An386,
        Self::Mps2An500,
        Self::Mps3An547,
        Self::Stm32F405,
    ];

    /// Returns the name of the board.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mps2An386 => "mps2-an386",
            Self::Mps2An500 => "mps2-an500",
            Self::Mps3An547 => "mps3-an547",
            Self::Stm32F405 => "stm32f405",
        }
    }

    /// Returns the board that this firmware was built for, if it names another one than `self`.
    pub fn other_in(self, elf: &[u8]) -> Option<Self> {
        let names = |board: Self| {
            let name = board.name().as_bytes();
            elf.windows(name.len()).any(|bytes| bytes == name)
        };
        if names(self) {
            return None;
        }
        Self::ALL.into_iter().find(|board| names(*board))
    }

    /// Returns QEMU's name of the machine.
    pub const fn machine(self) -> &'static str {
        match self {
            Self::Mps2An386 | Self::Mps2An500 | Self::Mps3An547 => self.name(),
            Self::Stm32F405 => "netduinoplus2",
        }
    }

    /// Returns the processor's name, as compiler and QEMU have it.
    pub const fn cpu(self) -> &'static str {
        match self {
            Self::Mps2An386 | Self::Stm32F405 => "cortex-m4",
            Self::Mps2An500 => "cortex-m7",
            Self::Mps3An547 => "cortex-m55",
        }
    }

    /// Returns the size in MiB of the memory that stands for the flash, where QEMU can keep that memory in a file.
    pub const fn memory_mib(self) -> Option<u32> {
        match self {
            Self::Mps2An386 | Self::Mps2An500 => Some(16),
            // All of its DDR, because QEMU accepts no less. The file takes disk space only for what was written.
            Self::Mps3An547 => Some(2_048),
            Self::Stm32F405 => None,
        }
    }

    /// Returns address and size in bytes of the flash behind the image. QEMU reads zeros there, but erased flash reads ones.
    pub const fn erased_flash(self) -> Option<(u32, usize)> {
        match self {
            Self::Mps2An386 | Self::Mps2An500 | Self::Mps3An547 => None,
            Self::Stm32F405 => Some((0x0804_0000, 6 * 128 * 1024)),
        }
    }
}
