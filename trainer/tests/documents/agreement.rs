//! Links have targets, and texts and numbers agree with their sources.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{document, documents, workspace};

/// The page with the recorded figures of the device.
const RECORD: &str = "docs/evidence/performance.md";

/// The generated page.
const COMMANDS: &str = "docs/reference/commands.md";

/// Returns the anchor of a heading: lower case, hyphens for spaces, no punctuation.
fn anchor(heading: &str) -> String {
    let kept: String = heading
        .trim()
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c))
        .collect();
    kept.replace(' ', "-")
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

/// Pages that are named in sources and in the program's texts exist.
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

/// The page equals the help of the command line. `POEGP_BLESS=1` rewrites it.
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

/// Pages that people read from beginning to end stay short.
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

/// Numbers that a page quotes are those of the record.
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
