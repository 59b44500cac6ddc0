//! Blocks of a document that are files or commands, and how the tests run them.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::document;
#[cfg(unix)]
use crate::firmware_build;

/// The instruction of the README's block that leads from a clone to a report.
pub const FIRST: &str = "first";

/// The command that builds the firmware in a clone.
#[cfg(unix)]
const FIRMWARE: &str = "cargo run --release -p poegp-tests --example firmware ";

/// A fenced block that is part of the test.
pub struct Block {
    /// The text of the comment after "test: ".
    pub instruction: String,
    /// Line of the comment, from 1.
    pub line: usize,
    pub text: String,
}

pub fn blocks(name: &str) -> Vec<Block> {
    let text = document(name);
    let mut lines = text.lines().enumerate();
    let mut blocks = Vec::new();
    while let Some((index, line)) = lines.next() {
        let Some(instruction) = line
            .strip_prefix("<!-- test: ")
            .and_then(|rest| rest.strip_suffix(" -->"))
        else {
            continue;
        };
        let fence = lines.next().map_or("", |(_, line)| line);
        assert!(fence.starts_with("```"), "{name}:{}: no block", index + 2);
        let inside = lines.by_ref().take_while(|(_, line)| *line != "```");
        blocks.push(Block {
            instruction: instruction.to_owned(),
            line: index + 1,
            text: inside.map(|(_, line)| format!("{line}\n")).collect(),
        });
    }
    assert!(!blocks.is_empty(), "{name} has no block to test");
    blocks
}

pub fn new_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Runs every block of a document and returns the folder.
pub fn run(name: &str) -> PathBuf {
    let folder = new_folder(&name.replace(['/', '.'], "_"));
    run_in(&folder, name);
    folder
}

/// Runs every block of a document in a folder that exists.
pub fn run_in(folder: &Path, name: &str) {
    let mut background = Background(Vec::new());
    for block in blocks(name) {
        let place = format!("{name}:{}", block.line);
        match block.instruction.split_once(' ') {
            Some(("file", file)) => fs::write(folder.join(file), &block.text).unwrap(),
            Some(("add", file)) => {
                let before = fs::read_to_string(folder.join(file)).unwrap();
                fs::write(folder.join(file), before + "\n" + &block.text).unwrap();
            }
            None if block.instruction == "run" => {
                run_block(&block, folder, 0, &place, &mut background)
            }
            None if block.instruction == FIRST => {}
            Some(("run,", exit)) => {
                let code = exit.strip_prefix("exit ").and_then(|c| c.parse().ok());
                let code = code.unwrap_or_else(|| panic!("{place}: {exit:?}"));
                run_block(&block, folder, code, &place, &mut background);
            }
            _ => panic!("{place}: unknown instruction {:?}", block.instruction),
        }
    }
}

/// Programs that run in the background; they are ended when this is dropped.
pub struct Background(pub Vec<Child>);

impl Background {
    /// Starts a program and waits until it has closed its standard output, which `device emulate` does once it is ready.
    fn start(&mut self, mut command: Command) -> String {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut printed = String::new();
        let mut stdout = child.stdout.take().unwrap();
        stdout.read_to_string(&mut printed).unwrap();
        self.0.push(child);
        printed
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

pub fn run_block(
    block: &Block,
    folder: &Path,
    exit: i32,
    place: &str,
    background: &mut Background,
) {
    let (mut commands, mut printed) = (0, String::new());
    for line in block.text.replace("\\\n", " ").lines() {
        let typed = line.strip_prefix("$ ").unwrap_or(line);
        #[cfg(unix)]
        if let Some(file) = typed.strip_prefix(FIRMWARE) {
            let image = firmware_build::firmware().unwrap_or_else(|error| panic!("{error}"));
            fs::copy(&image.elf, folder.join(file)).unwrap();
            continue;
        }
        if let Some(rest) = typed.strip_prefix("until [ -S ") {
            let (socket, rest) = rest.split_once(' ').unwrap();
            assert!(
                rest.starts_with("]; do sleep 0.1; done"),
                "{place}: {typed}"
            );
            assert!(folder.join(socket).exists(), "{place}: no {socket}");
            continue;
        }
        let Some(arguments) = typed.strip_prefix("trainer ") else {
            let is_output = !line.is_empty() && !line.starts_with('#');
            assert!(
                !is_output || printed.contains(line),
                "{place}: {line:?} is not in\n{printed}"
            );
            continue;
        };
        assert!(
            !typed.contains(['"', '\'', '|', '$', '>']),
            "{place}: there is no shell for {typed:?}"
        );
        commands += 1;
        let mut command = Command::new(env!("CARGO_BIN_EXE_trainer"));
        command.current_dir(folder);
        if let Some(arguments) = arguments.strip_suffix('&') {
            command.args(arguments.split_whitespace());
            printed = background.start(command);
            continue;
        }
        let output = command.args(arguments.split_whitespace()).output().unwrap();
        printed = String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr);
        let code = output.status.code();
        assert_eq!(code, Some(exit), "{place}: {typed}\n{printed}");
    }
    assert!(commands > 0, "{place}: no command");
}
