//! Builds the device image with an installed compiler, once for each program and board.
//!
//! There are two ways to build an image, and both give the same bits:
//!
//! | way | needs | searched |
//! |---|---|---|
//! | prebuilt | a toolchain with the target's `core`: `rustup target add thumbv7em-none-eabihf` | first |
//! | build-std | a compiler with its library's source and `ld.lld`: Debian's `rustc-web cargo-web rust-web-src lld` | then |
//!
//! `POEGP_TOOLCHAIN=prebuilt` or `build-std` selects one of them. The nested cargo gets no settings of the outer one: flags
//! for coverage or another processor must not reach the device.
//!
//! The image does not depend on where it was built: the folders of the sources, of the crates and of the build have
//! fixed names in it (`tests/tests/device/reproducible.rs` compares two images).

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::{env, fs};

pub use poegp_trainer::device::board::Board;

/// Target triple of the default board, and of every Cortex-M4F and M7.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// Environment variable that selects one of the toolchains.
pub const TOOLCHAIN_VARIABLE: &str = "POEGP_TOOLCHAIN";
const PACKAGE: &str = "poegp-firmware";
const PROFILE: &str = "firmware";

/// Returns the target triple of a board.
pub const fn target_of(board: Board) -> &'static str {
    match board {
        Board::Mps2An386 | Board::Mps2An500 | Board::Stm32F405 => TARGET,
        Board::Mps3An547 => "thumbv8m.main-none-eabihf",
    }
}

/// Returns the compiler flags for a board. The compiler does not learn that a Cortex-M55 has Helium, because its vector code
/// would flush denormal numbers to zero (`docs/decisions/arithmetic.md`), and its scalar code for that processor takes a
/// tenth more instructions.
fn flags(board: Board) -> Vec<String> {
    let cpu = match board {
        Board::Mps3An547 => None,
        Board::Mps2An386 | Board::Mps2An500 | Board::Stm32F405 => Some(board.cpu()),
    };
    let flag = cpu.map(|cpu| ["-C".to_owned(), format!("target-cpu={cpu}")]);
    flag.into_iter().flatten().collect()
}

/// The variants of the image of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Variant {
    /// The image that ships.
    #[default]
    Product,
    /// The innermost loops are compiled from portable source instead of assembly for a Cortex-M4F; the results are
    /// bit-identical.
    PortableKernels,
    /// The image contains planted faults that a test can request.
    PlantedFaults,
    /// The image assumes that the clock is right, because QEMU does not emulate the clock tree of the STM32F405.
    StatedClock,
    /// The link of the STM32F405 runs over SPI.
    SpiLink,
}

impl Variant {
    /// All variants.
    pub const ALL: [Self; 5] = [
        Self::Product,
        Self::PortableKernels,
        Self::PlantedFaults,
        Self::StatedClock,
        Self::SpiLink,
    ];

    /// Returns the firmware's cargo feature for this variant, if it has one.
    fn feature(self) -> Option<&'static str> {
        match self {
            Self::Product => None,
            Self::PortableKernels => Some("portable-kernels"),
            Self::PlantedFaults => Some("planted-faults"),
            Self::StatedClock => Some("stated-clock"),
            Self::SpiLink => Some("spi-link"),
        }
    }
}

/// Returns the root of the workspace.
fn workspace() -> &'static Path {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.parent().unwrap_or(package)
}

/// A compiler that can build for the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Toolchain {
    /// The `core` of the target is installed.
    Prebuilt {
        /// Path of the compiler.
        rustc: PathBuf,
    },
    /// `core` is built from source.
    BuildStd {
        /// Path of the compiler.
        rustc: PathBuf,
    },
}

impl fmt::Display for Toolchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Prebuilt { rustc } => write!(f, "prebuilt core of {}", rustc.display()),
            Self::BuildStd { rustc } => write!(f, "core built from source by {}", rustc.display()),
        }
    }
}

/// A built device image.
#[derive(Clone, Debug)]
pub struct Firmware {
    /// The ELF file.
    pub elf: PathBuf,
    /// The toolchain that built it.
    pub toolchain: Toolchain,
}

/// Returns the name of the build folder; each image has its own.
fn folder(board: Board, variant: Variant, toolchain: &Toolchain) -> String {
    let way = match toolchain {
        Toolchain::Prebuilt { .. } => "device",
        Toolchain::BuildStd { .. } => "device-build-std",
    };
    let of_board = match board {
        Board::Mps2An386 => way.to_owned(),
        other => format!("{way}-{}", other.name()),
    };
    match variant {
        Variant::Product => of_board,
        Variant::PortableKernels => format!("{of_board}-portable"),
        Variant::PlantedFaults => format!("{of_board}-planted-faults"),
        Variant::StatedClock => format!("{of_board}-stated-clock"),
        Variant::SpiLink => format!("{of_board}-spi-link"),
    }
}

/// Why an image could not be built.
#[derive(Clone, Debug, thiserror::Error)]
pub enum FirmwareError {
    /// No compiler can build for the device.
    #[error(
        "no compiler can build for {target}{}\nhelp: either `rustup target add {target}`, \
         or `apt-get install rustc-web cargo-web rust-web-src lld` (Debian)",
        .asked.as_ref().map(|way| format!(" ({TOOLCHAIN_VARIABLE}={way})")).unwrap_or_default()
    )]
    NoToolchain {
        /// The target triple.
        target: &'static str,
        /// The toolchain that was requested.
        asked: Option<String>,
    },
    /// [`TOOLCHAIN_VARIABLE`] has an unknown value.
    #[error("{TOOLCHAIN_VARIABLE} is {0:?}; it can be `prebuilt` or `build-std`")]
    UnknownToolchain(String),
    /// The build failed.
    #[error("the firmware does not build with {toolchain}:\n{output}")]
    Build {
        /// The toolchain that was used.
        toolchain: String,
        /// Output of cargo.
        output: String,
    },
}

/// Returns the image of a board, built at the first call. Programs that run at the same time wait for one another in cargo.
///
/// # Errors
/// [`FirmwareError`].
pub fn firmware_of(board: Board) -> Result<&'static Firmware, FirmwareError> {
    firmware_with(board, Variant::default())
}

/// Returns one variant of the image of a board.
///
/// # Errors
/// [`FirmwareError`].
pub fn firmware_with(board: Board, variant: Variant) -> Result<&'static Firmware, FirmwareError> {
    static BUILT: [[OnceLock<Result<Firmware, FirmwareError>>; Board::ALL.len()];
        Variant::ALL.len()] =
        [const { [const { OnceLock::new() }; Board::ALL.len()] }; Variant::ALL.len()];
    BUILT[variant as usize][board as usize]
        .get_or_init(|| {
            let target = env::var_os("CARGO_TARGET_DIR")
                .map_or_else(|| workspace().join("target"), |dir| workspace().join(dir));
            let toolchain = find_toolchain(target_of(board))?;
            build(workspace(), &target, board, variant, toolchain)
        })
        .as_ref()
        .map_err(Clone::clone)
}

/// Returns the image of the default board.
///
/// # Errors
/// [`FirmwareError`].
pub fn firmware() -> Result<&'static Firmware, FirmwareError> {
    firmware_of(Board::default())
}

/// Builds the image of a board from a copy of the sources in `source`, in a folder below `target`, which need not exist.
///
/// # Errors
/// [`FirmwareError`].
pub fn firmware_from(
    source: &Path,
    target: &Path,
    board: Board,
) -> Result<Firmware, FirmwareError> {
    let toolchain = find_toolchain(target_of(board))?;
    build(source, target, board, Variant::default(), toolchain)
}

fn find_toolchain(target: &'static str) -> Result<Toolchain, FirmwareError> {
    let asked = env::var(TOOLCHAIN_VARIABLE).ok();
    let found = match asked.as_deref() {
        None => prebuilt(target).or_else(build_std),
        Some("prebuilt") => prebuilt(target),
        Some("build-std") => build_std(),
        Some(other) => return Err(FirmwareError::UnknownToolchain(other.to_owned())),
    };
    found.ok_or(FirmwareError::NoToolchain { target, asked })
}

/// Compilers to try: the user's `rustc`, then the distribution's.
const COMPILERS: [&str; 2] = ["rustc", "/usr/bin/rustc"];

fn prebuilt(target: &str) -> Option<Toolchain> {
    COMPILERS.iter().find_map(|rustc| {
        let directory = printed(rustc, &["--print", "target-libdir", "--target", target])?;
        fs::read_dir(directory)
            .ok()?
            .flatten()
            .any(|file| file.file_name().to_string_lossy().starts_with("libcore-"))
            .then(|| Toolchain::Prebuilt {
                rustc: rustc.into(),
            })
    })
}

fn build_std() -> Option<Toolchain> {
    // The compiler has no linker of rustup in its sysroot, so it needs this one.
    succeeds(Command::new("ld.lld").arg("--version"))?;
    COMPILERS.iter().find_map(|rustc| {
        let sysroot = printed(rustc, &["--print", "sysroot"])?;
        Path::new(&sysroot)
            .join("lib/rustlib/src/rust/library/core/src/lib.rs")
            .exists()
            .then(|| Toolchain::BuildStd {
                rustc: rustc.into(),
            })
    })
}

fn succeeds(command: &mut Command) -> Option<Output> {
    command
        .output()
        .ok()
        .filter(|output| output.status.success())
}

fn printed(program: &str, arguments: &[&str]) -> Option<String> {
    let output = succeeds(clean(&mut Command::new(program)).args(arguments))?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// Removes the environment variables that the outer cargo or its caller has set.
fn clean(command: &mut Command) -> &mut Command {
    const PREFIXES: [&str; 5] = [
        "CARGO_TARGET_",
        "CARGO_PROFILE_",
        "CARGO_BUILD_",
        "CARGO_ENCODED_",
        "RUSTC",
    ];
    const NAMES: [&str; 3] = ["RUSTFLAGS", "CARGO_INCREMENTAL", "LLVM_PROFILE_FILE"];
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        if NAMES.contains(&&*text) || PREFIXES.iter().any(|prefix| text.starts_with(prefix)) {
            command.env_remove(&name);
        }
    }
    command.current_dir(workspace())
}

/// Returns the names by which the compiler replaces folders of this machine, so that the image does not contain their paths.
/// If two entries match a path, the compiler uses the last.
fn renamed_folders(source: &Path, target: &Path, rustc: &Path) -> Vec<(PathBuf, &'static str)> {
    let mut renamed = vec![(source.to_owned(), "/poegp")];
    let cargo = env::var_os("CARGO_HOME")
        .map(PathBuf::from)
        .or_else(|| env::home_dir().map(|home| home.join(".cargo")));
    if let Some(cargo) = cargo {
        // The folder of a registry is named after its address, which may be that of a mirror.
        let registries = fs::read_dir(cargo.join("registry/src"));
        let mut folders: Vec<_> = registries
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| (entry.path(), "/crates"))
            .collect();
        folders.sort();
        renamed.push((cargo, "/cargo"));
        renamed.extend(folders);
    }
    if let Some(sysroot) = printed(&rustc.to_string_lossy(), &["--print", "sysroot"]) {
        renamed.push((Path::new(&sysroot).join("lib/rustlib/src/rust"), "/rust"));
    }
    renamed.push((target.to_owned(), "/target"));
    renamed
}

fn build(
    source: &Path,
    target: &Path,
    board: Board,
    variant: Variant,
    toolchain: Toolchain,
) -> Result<Firmware, FirmwareError> {
    let directory = target.join(folder(board, variant, &toolchain));
    let (Toolchain::Prebuilt { rustc } | Toolchain::BuildStd { rustc }) = &toolchain;
    // The cargo that belongs to the compiler.
    let mut command = Command::new(rustc.with_file_name("cargo"));
    let triple = target_of(board);
    let flags: Vec<String> = flags(board)
        .into_iter()
        .chain(
            renamed_folders(source, &directory, rustc)
                .iter()
                .map(|(folder, name)| format!("--remap-path-prefix={}={name}", folder.display())),
        )
        .collect();
    clean(&mut command)
        .current_dir(source)
        .args(["build", "--locked", "--package", PACKAGE])
        .args(["--profile", PROFILE, "--target", triple])
        .args(["--no-default-features", "--features", board.name()])
        // Flags are passed as an argument so that the workspace needs no configuration file.
        .arg("--config")
        // A list of strings is written the same way in Rust and in TOML. The triple is not quoted, even if it has a dot:
        // cargo looks for tables in tables, and would silently ignore the flags.
        .arg(format!("target.{triple}.rustflags={flags:?}"))
        .arg("--target-dir")
        .arg(&directory)
        .env("RUSTC", rustc)
        // Without this variable, defmt compiles in only errors.
        .env("DEFMT_LOG", "info");
    if let Some(feature) = variant.feature() {
        command.args(["--features", feature]);
    }
    if let Toolchain::BuildStd { .. } = toolchain {
        let linker = triple.replace(['-', '.'], "_").to_uppercase();
        command
            .arg("-Zbuild-std=core")
            .env("RUSTC_BOOTSTRAP", "1")
            .env(format!("CARGO_TARGET_{linker}_LINKER"), "ld.lld");
    }
    let failed = |output| FirmwareError::Build {
        toolchain: toolchain.to_string(),
        output,
    };
    let output = command
        .output()
        .map_err(|error| failed(error.to_string()))?;
    if !output.status.success() {
        return Err(failed(String::from_utf8_lossy(&output.stderr).into_owned()));
    }
    Ok(Firmware {
        elf: directory.join(triple).join(PROFILE).join(PACKAGE),
        toolchain,
    })
}
