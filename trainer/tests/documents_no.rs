//! The page on refused measurements quotes the program's messages, and names every cause.
//!
//! A block after `<!-- says: MISTAKE -->` is the trainer's message about that mistake of the corpus in
//! `calibration/tests/trust`, applied to a simulated set. `POEGP_BLESS=1` rewrites the blocks.

use std::fs;
use std::path::Path;
use std::process::Command;

use poegp_calibration::trust::Cause;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

#[allow(dead_code, reason = "the corpus uses more of it")]
#[path = "../../calibration/tests/trust/mistakes/mod.rs"]
mod mistakes;
#[allow(dead_code, reason = "the corpus uses more of it")]
#[path = "../../calibration/tests/trust/sets.rs"]
mod sets;
#[allow(dead_code, reason = "the corpus uses more of it")]
#[path = "../../calibration/tests/trust/table.rs"]
mod table;

const PAGE: &str = "docs/guide/when-it-says-no.md";
/// Width of a line in a block.
const WIDTH: usize = 130;

fn page() -> (std::path::PathBuf, String) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(PAGE);
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{PAGE}: {e}"));
    (path, text)
}

/// Returns the program's message about a mistake in the simulated set `paper`: standard error before the help line.
fn says(mistake: &str) -> String {
    let good = &sets::simulated_files()[0];
    let all = mistakes::all(good);
    let found = all.iter().find(|m| m.name == mistake);
    let found = found.unwrap_or_else(|| panic!("{PAGE}: no mistake {mistake:?}"));
    let table = found.table(good, &mut ChaCha8Rng::seed_from_u64(1));
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("measured.csv"), table.text()).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_trainer"))
        .current_dir(folder.path())
        .args(["calibrate", "--quiet", "--robot", &good.robot.name])
        .args(["measured.csv", "--method", "poe", "--out", "arm.blob"])
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    let expected = if found.only_warns { 0 } else { 3 };
    assert_eq!(output.status.code(), Some(expected), "{mistake}: {printed}");
    let (said, _) = printed.split_once("\nhelp: ").unwrap_or((&printed, ""));
    said.trim_end().to_owned()
}

/// Returns the text wrapped to at most [`WIDTH`] columns; existing line breaks stay.
fn wrapped(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines() {
        let mut column = 0;
        for word in line.split_whitespace() {
            let width = word.chars().count();
            if column > 0 && column + 1 + width > WIDTH {
                out.push('\n');
                column = 0;
            } else if column > 0 {
                out.push(' ');
                column += 1;
            }
            out += word;
            column += width;
        }
        out.push('\n');
    }
    out
}

#[test]
fn the_page_on_refusals_quotes_the_program() {
    let (path, text) = page();
    let mut new = String::new();
    let mut lines = text.lines();
    let mut blocks = 0;
    while let Some(line) = lines.next() {
        new += line;
        new.push('\n');
        let mistake = line
            .strip_prefix("<!-- says: ")
            .and_then(|l| l.strip_suffix(" -->"));
        let Some(mistake) = mistake else { continue };
        blocks += 1;
        assert_eq!(
            lines.next(),
            Some("```text"),
            "{PAGE}: no block of {mistake}"
        );
        let quoted: Vec<&str> = lines.by_ref().take_while(|l| *l != "```").collect();
        let said = wrapped(&says(mistake));
        new += &format!("```text\n{said}```\n");
        let is_blessed = std::env::var_os("POEGP_BLESS").is_some();
        let is_same = quoted.iter().eq(said.lines().collect::<Vec<_>>().iter());
        assert!(
            is_blessed || is_same,
            "{PAGE}: the program's message about {mistake} is\n{said}"
        );
    }
    assert!(blocks > 5);
    if new != text {
        fs::write(path, new).unwrap();
    }
}

#[test]
fn the_page_on_refusals_names_every_cause() {
    let (_, text) = page();
    for cause in Cause::ALL {
        assert!(
            text.contains(&format!("\n| `{cause}` |")),
            "{PAGE}: {cause}"
        );
    }
    let words = text.split_whitespace().count();
    assert!(words <= 1500, "{PAGE}: {words} words");
}
