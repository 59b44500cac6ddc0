//! The documents of the workspace: their commands work, their links lead somewhere, and their numbers agree.
//!
//! A fenced block after one of these comments, which a browser does not show, is part of the test:
//!
//! ```text
//! <!-- test: file NAME -->       the block is written to NAME
//! <!-- test: run -->             lines that start with "trainer" or "$ trainer" are run, in order
//! <!-- test: run, exit 2 -->     the same, and the program must end so; other lines must be part of what it prints
//! <!-- test: first -->           run by a test of its own
//! ```
//!
//! In a block that is run, `cargo run --release -p poegp-tests --example firmware FILE` builds the image without that cargo.
//! All blocks of a document share one new folder. There is no shell: no quotes, pipes or variables. A line that ends with
//! `&` goes on in the background until the end of the document; the next waits until it has printed what it has to say.
//! `until [ -S FILE ]; do sleep 0.1; done` waits for a socket in a shell; here it must exist.
//!
//! `<!-- record: ROW -->NUMBER` quotes the record of docs/evidence/performance.md.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

#[cfg(unix)]
#[allow(dead_code, reason = "the tests of the device use more of it")]
#[path = "../../tests/src/firmware_build.rs"]
mod firmware_build;

/// Where the device's figures are recorded.
const RECORD: &str = "docs/evidence/performance.md";

/// The generated page.
const COMMANDS: &str = "docs/reference/commands.md";

/// Instruction of the README's way from a clone to a report.
const FIRST: &str = "first";

/// What builds the firmware in a clone.
#[cfg(unix)]
const FIRMWARE: &str = "cargo run --release -p poegp-tests --example firmware ";

/// A fenced block that is part of the test.
struct Block {
    /// What the comment says after "test: ".
    instruction: String,
    /// Line of the comment, from 1.
    line: usize,
    text: String,
}

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the package lies in the workspace")
}

fn document(name: &str) -> String {
    fs::read_to_string(workspace().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn blocks(name: &str) -> Vec<Block> {
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

fn new_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Runs every block of a document and returns the folder.
fn run(name: &str) -> PathBuf {
    let folder = new_folder(&name.replace(['/', '.'], "_"));
    run_in(&folder, name);
    folder
}

/// Runs every block of a document in a folder that exists.
fn run_in(folder: &Path, name: &str) {
    let mut background = Background(Vec::new());
    for block in blocks(name) {
        let place = format!("{name}:{}", block.line);
        match block.instruction.split_once(' ') {
            Some(("file", file)) => fs::write(folder.join(file), &block.text).unwrap(),
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

/// Programs that go on; ended with this.
struct Background(Vec<Child>);

impl Background {
    /// Starts a program and waits until it has closed its standard output, which `device emulate` gives away once it is
    /// ready.
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

fn run_block(block: &Block, folder: &Path, exit: i32, place: &str, background: &mut Background) {
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

#[test]
fn the_commands_work() {
    let folder = run("docs/guide/examples.md");
    for file in [
        "arm.blob",
        "compare.json",
        "report.html",
        "predicted.csv",
        "errors.json",
        "corrected.csv",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// The README's four commands, on simulated poses of the arm that they name. Cloning and installing are looked at only.
#[test]
fn four_commands_lead_from_a_clone_to_a_report() {
    let folder = new_folder("first");
    let block = blocks("README.md")
        .into_iter()
        .find(|block| block.instruction == FIRST)
        .expect("the README has a block for new users");
    let lines: Vec<&str> = block.text.lines().collect();
    let [clone, enter, install, calibrate] = lines[..] else {
        panic!("four commands, not {lines:#?}");
    };
    assert!(clone.starts_with("git clone ") && enter.starts_with("cd "));
    let package = install.rsplit(' ').next().unwrap();
    assert!(install.starts_with("cargo install "), "{install}");
    assert!(workspace().join(package).join("Cargo.toml").is_file());

    let words: Vec<&str> = calibrate.split_whitespace().collect();
    let robot = words.iter().position(|word| *word == "--robot").unwrap();
    let simulate = format!(
        "trainer simulate --robot {} --poses 60 --test-sets 0 --out cell\n",
        words[robot + 1]
    );
    let background = &mut Background(Vec::new());
    for (text, place) in [(simulate.as_str(), "simulate"), (calibrate, "README.md")] {
        if text == calibrate {
            fs::copy(folder.join("cell/train.csv"), folder.join("measured.csv")).unwrap();
        }
        let block = Block {
            instruction: "run".to_owned(),
            line: block.line,
            text: text.to_owned(),
        };
        run_block(&block, &folder, 0, place, background);
    }
    for file in ["arm.blob", "report.html"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_commands_of_the_tutorial_work() {
    let folder = run("docs/guide/tutorial.md");
    for file in ["plan.mod", "first.csv", "report.html", "check.json"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    for file in ["program.csv", "from-device.csv"] {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        assert_eq!(rows.count(), 101, "{file}");
    }
}

#[test]
fn the_commands_of_the_page_on_programs_work() {
    let folder = run("docs/guide/into-the-cell.md");
    let [weld, corrected, original] = ["weld.mod", "corrected.mod", "original.mod"]
        .map(|name| fs::read_to_string(folder.join(name)).unwrap());
    assert_ne!(weld, corrected);
    assert!(!folder.join("twice.mod").exists());
    let moves = |text: &str| text.matches("MoveAbsJ").count();
    assert_eq!(moves(&weld), moves(&corrected));
    assert_eq!(original.lines().count(), weld.lines().count());
}

#[test]
fn the_commands_of_the_page_on_projects_work() {
    let folder = run("docs/guide/projects.md");
    assert!(folder.join("other.blob").is_file());
}

/// The project file of one robot of a fleet, on simulated poses of the robot that it names.
#[test]
fn the_project_of_the_page_on_fleets_works() {
    let page = "docs/guide/fleet.md";
    let folder = run(page);
    let text = "trainer simulate --robot abb-irb120 --poses 60 --test-sets 1 --out .\n\
                trainer calibrate fleet.toml --method poe --out arm.blob\n";
    let background = &mut Background(Vec::new());
    for (number, line) in text.lines().enumerate() {
        let block = Block {
            instruction: "run".to_owned(),
            line: number,
            text: format!("{line}\n"),
        };
        run_block(&block, &folder, 0, page, background);
        let _ = fs::rename(folder.join("train.csv"), folder.join("measured.csv"));
        let _ = fs::rename(folder.join("test1.csv"), folder.join("test.csv"));
    }
    assert!(folder.join("arm.blob").is_file());
}

#[test]
fn the_commands_of_the_page_on_results_work() {
    let folder = run("docs/guide/reading-results.md");
    for file in [
        "arm.blob",
        "report.html",
        "compare.html",
        "compare.json",
        "check.json",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// x, y, z in mm of every row of a file of predictions.
fn positions(file: &Path) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(file).unwrap();
    let row = |line: &str| {
        let mut fields = line.split(',').map(|field| field.parse().unwrap());
        std::array::from_fn(|_| fields.next().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn the_examples_of_robots_and_measurements_work_and_describe_one_robot_three_times() {
    let folder = run("docs/reference/robot-description.md");
    // By base-tool calibration: any other would fit the differences of the descriptions away.
    let poe = positions(&folder.join("poe.csv"));
    assert_eq!(poe.len(), 20);
    for other in ["dh.csv", "modified-dh.csv"] {
        for (a, b) in poe.iter().zip(positions(&folder.join(other))) {
            let apart = (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
            assert!(apart < 2e-3, "{other}: {apart} mm apart");
        }
    }
    run_in(&folder, "docs/reference/measurement-file.md");
}

#[test]
fn the_examples_of_planning_work() {
    let folder = run("docs/guide/measuring.md");
    for file in ["plan.csv", "check.csv", "plan.mod"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_commands_of_the_page_without_a_tracker_work() {
    let folder = run("docs/guide/without-a-tracker.md");
    for file in [
        "touches.csv",
        "touches.toml",
        "practice/truth.csv",
        "practice.html",
        "corrected.script",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

#[test]
fn the_examples_of_importing_work() {
    let folder = run("docs/guide/import.md");
    for file in ["measured.csv", "points.csv", "tracker.csv.imported"] {
        assert!(folder.join(file).is_file(), "{file}");
    }
}

/// The anchor that a heading gets: lower case, spaces to hyphens, punctuation gone.
fn anchor(heading: &str) -> String {
    let kept: String = heading
        .trim()
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c))
        .collect();
    kept.replace(' ', "-")
}

/// Every Markdown file of the workspace.
fn documents() -> Vec<PathBuf> {
    fn collect(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let skipped = name.starts_with('.') || name == "target" || name == "demo";
            if path.is_dir() && !skipped {
                collect(&path, out);
            } else if name.ends_with(".md") {
                out.push(path);
            }
        }
    }
    let mut all = Vec::new();
    collect(workspace(), &mut all);
    all
}

#[test]
fn links_lead_somewhere() {
    let mut links = 0;
    for path in documents() {
        let (name, text) = (path.display(), fs::read_to_string(&path).unwrap());
        for rest in text.split("](").skip(1) {
            let link = rest.split(')').next().unwrap_or("");
            if link.starts_with("http") {
                continue;
            }
            links += 1;
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let file = match file {
                "" => path.clone(),
                _ => path.parent().unwrap().join(file),
            };
            assert!(file.exists(), "{name}: {link} leads nowhere");
            if heading.is_empty() {
                continue;
            }
            let target = fs::read_to_string(&file).unwrap();
            let headings = target.lines().filter(|line| line.starts_with('#'));
            assert!(
                headings
                    .map(|line| anchor(line.trim_start_matches('#')))
                    .any(|known| known == heading),
                "{name}: no heading for {link}"
            );
        }
    }
    assert!(links > 100, "only {links} links");
}

/// Pages that sources and texts of the program name are there.
#[test]
fn sources_name_pages_that_exist() {
    fn collect(folder: &Path, names: &mut Vec<(PathBuf, String)>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(&path, names);
            } else if path.extension().is_some_and(|e| e == "rs" || e == "toml") {
                let text = fs::read_to_string(&path).unwrap();
                for rest in text.split("docs/").skip(1) {
                    let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && !"-/.".contains(c));
                    let page = rest[..end.unwrap_or(rest.len())].trim_end_matches('.');
                    if page.ends_with(".md") {
                        names.push((path.clone(), format!("docs/{page}")));
                    }
                }
            }
        }
    }
    let mut names = Vec::new();
    for folder in [
        "protocol",
        "runtime",
        "calibration",
        "trainer",
        "firmware",
        "tests/src",
        "tests/tests",
    ] {
        collect(&workspace().join(folder), &mut names);
    }
    for (source, page) in &names {
        assert!(
            workspace().join(page).is_file(),
            "{}: {page}",
            source.display()
        );
    }
    assert!(names.len() > 20, "only {} names", names.len());
}

/// The page is what the command line is. `POEGP_BLESS=1` rewrites it.
#[test]
fn command_reference() {
    let page = poegp_trainer::cli::command_reference();
    if std::env::var_os("POEGP_BLESS").is_some() {
        fs::write(workspace().join(COMMANDS), &page).unwrap();
    }
    assert!(
        document(COMMANDS) == page,
        "{COMMANDS} is stale: POEGP_BLESS=1 cargo test -p poegp-trainer --test documents command_reference"
    );
}

/// Pages that somebody reads from the beginning to the end stay short.
#[test]
fn guides_are_short() {
    let guides = fs::read_dir(workspace().join("docs/guide")).unwrap();
    let names = guides.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let pages = names.filter(|name| name.ends_with(".md"));
    let pages = pages.map(|name| (format!("docs/guide/{name}"), 1500));
    let others = [("README.md", 900), ("ARCHITECTURE.md", 1500)];
    let others = others.map(|(name, most)| (name.to_owned(), most));
    for (name, most) in pages.chain(others) {
        let words = document(&name).split_whitespace().count();
        assert!(words <= most, "{name}: {words} words, at most {most}");
    }
}

/// Numbers that a page repeats are those of the record.
#[test]
fn quoted_numbers_are_those_of_the_record() {
    let record = document(RECORD);
    let (_, table) = record.split_once("\n## Record\n").unwrap();
    let table = table.split("\n## ").next().unwrap();
    let mut quotes = 0;
    for path in documents() {
        let text = fs::read_to_string(&path).unwrap();
        for rest in text.split("<!-- record: ").skip(1) {
            let (row, rest) = rest.split_once(" -->").unwrap();
            let end = rest.find(|c: char| !c.is_ascii_digit() && c != ' ');
            let quoted = rest[..end.unwrap()].trim_end();
            let line = table
                .lines()
                .find(|line| line.starts_with(&format!("| {row} |")))
                .unwrap_or_else(|| panic!("{}: no record of {row}", path.display()));
            let recorded = line.split('|').nth(2).unwrap().trim();
            assert_eq!(quoted, recorded, "{}: {row}", path.display());
            quotes += 1;
        }
    }
    assert!(quotes >= 3, "only {quotes} quotes");
}
