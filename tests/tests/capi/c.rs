//! Builds the static library and C programs, and runs them.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use poegp_tests::firmware_build::{TARGET, Toolchain, firmware};
use poegp_tests::workspace;

/// Where a program runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Machine {
    /// On this machine.
    Host,
    /// On an emulated Cortex-M4F.
    Device,
}

/// Time limit of a program.
const TIME_LIMIT: Duration = Duration::from_secs(60);
/// The strictest warnings that gcc has for C11; the header must pass them too.
const WARNINGS: [&str; 5] = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"];
const CORTEX_M4F: [&str; 4] = [
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfloat-abi=hard",
    "-mfpu=fpv4-sp-d16",
];

/// Returns the folder of the C interface.
pub fn capi() -> PathBuf {
    workspace().join("runtime/capi")
}

/// Returns the static library, built at the first call.
fn library(machine: Machine) -> &'static Path {
    static BUILT: [OnceLock<PathBuf>; 2] = [const { OnceLock::new() }; 2];
    BUILT[machine as usize].get_or_init(|| build_library(machine))
}

fn build_library(machine: Machine) -> PathBuf {
    let directory = env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| workspace().join("target"), |dir| workspace().join(dir))
        .join("capi");
    let mut cargo = PathBuf::from(env!("CARGO"));
    let mut place = directory.clone();
    let mut options = Vec::new();
    if machine == Machine::Device {
        // The compiler that the firmware's build found; the firmware is built as well, as for the tests of the device.
        let toolchain = &firmware()
            .unwrap_or_else(|error| panic!("{error}"))
            .toolchain;
        let (Toolchain::Prebuilt { rustc } | Toolchain::BuildStd { rustc }) = toolchain;
        cargo = rustc.with_file_name("cargo");
        place.push(TARGET);
        options = vec![
            format!("--target={TARGET}"),
            format!(r#"--config=target.{TARGET}.rustflags=["-C","target-cpu=cortex-m4"]"#),
        ];
        if let Toolchain::BuildStd { .. } = toolchain {
            options.push("-Zbuild-std=core".to_owned());
        }
    }
    let mut command = Command::new(cargo);
    // Settings of the outer cargo must not reach this one.
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        let told = [
            "CARGO_TARGET_",
            "CARGO_PROFILE_",
            "CARGO_BUILD_",
            "CARGO_ENCODED_",
            "RUSTC",
        ];
        if told.iter().any(|prefix| text.starts_with(prefix)) || text == "RUSTFLAGS" {
            command.env_remove(&name);
        }
    }
    if options
        .last()
        .is_some_and(|option| option.starts_with("-Z"))
    {
        command.env("RUSTC_BOOTSTRAP", "1");
    }
    command
        .args(["rustc", "--locked", "--package", "poegp-capi", "--lib"])
        .args(["--crate-type", "staticlib", "--profile", "firmware"])
        .args(options)
        .arg("--target-dir")
        .arg(directory)
        .current_dir(workspace());
    finish(&mut command, "install Rust");
    place.join("firmware/libpoegp_capi.a")
}

/// Returns the output of a program that ended successfully.
fn finish(command: &mut Command, remedy: &str) -> String {
    let output = command.output().unwrap_or_else(|error| match error.kind() {
        ErrorKind::NotFound => panic!("{:?} is not installed: {remedy}", command.get_program()),
        _ => panic!("{command:?}: {error}"),
    });
    assert!(
        output.status.success(),
        "{command:?}: {}\n{}{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Compiles one C file with the static library into `program`. It may include and `.incbin` files from `folders`.
pub fn compile(machine: Machine, source: &Path, folders: &[&Path], program: &Path) {
    let (compiler, remedy) = match machine {
        Machine::Host => ("cc", "apt-get install gcc (Debian)"),
        Machine::Device => (
            "arm-none-eabi-gcc",
            "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi (Debian)",
        ),
    };
    let mut command = Command::new(compiler);
    command.args(WARNINGS).arg("-I").arg(capi().join("include"));
    for folder in folders {
        command.arg("-I").arg(folder);
        command.arg(format!("-Wa,-I,{}", folder.display()));
    }
    match machine {
        Machine::Host => command.arg("-O2"),
        Machine::Device => command
            .args(CORTEX_M4F)
            // The peer's speed is compared, and its results approximately.
            .args([
                "-O3",
                "-ffp-contract=off",
                "-ffunction-sections",
                "-fdata-sections",
            ])
            .args(["-nostartfiles", "-Wl,--gc-sections,-z,noexecstack", "-T"])
            .arg(capi().join("examples/device.ld")),
    };
    command.arg(source);
    match machine {
        Machine::Host => command
            .arg(library(machine))
            .args(["-lpthread", "-ldl", "-lm"]),
        // newlib comes first, because the Rust library has weak functions with the same names (expf, memcpy, …).
        Machine::Device => command.arg("-lm").arg(library(machine)),
    };
    finish(command.arg("-o").arg(program), remedy);
}

/// Compiles one C++17 file with the static library of the host into `program`, with additional options.
pub fn compile_cpp(source: &Path, options: &[&str], program: &Path) {
    let mut command = Command::new("g++");
    command
        .args([
            "-std=c++17",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-pedantic",
            "-O2",
        ])
        .args(options)
        .arg("-I")
        .arg(capi().join("include"))
        .arg(source)
        .arg(library(Machine::Host))
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(program);
    finish(&mut command, "apt-get install g++ (Debian)");
}

/// Returns the semihosting output of a program on the emulated device. With `counting`, an instruction takes 64 ns.
pub fn run_on_device(program: &Path, counting: bool) -> String {
    let said = program.with_extension("txt");
    let mut command = Command::new("qemu-system-arm");
    command
        .args(["-M", "mps2-an386", "-cpu", "cortex-m4", "-display", "none"])
        .args(["-monitor", "none", "-serial", "none", "-chardev"])
        .arg(format!("file,id=said,path={}", said.display()))
        .args([
            "-semihosting-config",
            "enable=on,target=native,chardev=said",
        ])
        .arg("-kernel")
        .arg(program)
        .stdin(Stdio::null());
    if counting {
        command.args(["-icount", "shift=6"]);
    }
    let mut child = command.spawn().unwrap_or_else(|error| {
        panic!("qemu-system-arm does not start: {error}; apt-get install qemu-system-arm (Debian)")
    });
    let started = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if started.elapsed() > TIME_LIMIT => {
                child.kill().unwrap();
                break child.wait().unwrap();
            }
            None => thread::sleep(Duration::from_millis(20)),
        }
    };
    let said = fs::read_to_string(said).unwrap();
    assert!(status.success(), "the program ended with {status}:\n{said}");
    said
}

/// Returns the output of a program on this machine.
pub fn run_on_host(program: &Path, argument: &Path) -> String {
    finish(Command::new(program).arg(argument), "compile it first")
}
