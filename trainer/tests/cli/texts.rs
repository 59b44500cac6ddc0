//! The program's messages, kept as files: `texts/{file}/{test}.txt` has the answers to the commands of a test.
//!
//! `POEGP_BLESS=1 cargo test -p poegp-trainer --test cli` rewrites them; read the difference before you commit it.

use std::cell::RefCell;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use snapbox::assert::{Action, Assert};
use snapbox::{Data, IntoData};

thread_local! {
    static TRANSCRIPT: RefCell<Option<String>> = const { RefCell::new(None) };
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/texts")
}

/// The answers of the program in this test, compared with the test's file when dropped.
pub struct Texts(());

/// Begins a test whose answers are compared.
pub fn texts() -> Texts {
    TRANSCRIPT.set(Some(String::new()));
    Texts(())
}

impl Drop for Texts {
    fn drop(&mut self) {
        let transcript = TRANSCRIPT.take().unwrap();
        if std::thread::panicking() {
            return;
        }
        let thread = std::thread::current();
        let test = thread.name().unwrap().replace("::", "/");
        let expected = Data::read_from(&folder().join(test).with_extension("txt"), None);
        let action = match std::env::var_os("POEGP_BLESS") {
            Some(_) => Action::Overwrite,
            None => Action::Verify,
        };
        let assert = Assert::new().normalize_paths(false).action(action);
        if let Err(error) = assert.try_eq(None, transcript.into_data(), expected.raw()) {
            panic!(
                "{error}\nPOEGP_BLESS=1 cargo test -p poegp-trainer --test cli writes the files"
            );
        }
    }
}

/// Adds a command and its answer, unless another command had the same answer.
#[track_caller]
pub fn record(line: &str, answer: &str) {
    TRANSCRIPT.with_borrow_mut(|transcript| {
        let transcript = transcript
            .as_mut()
            .expect("let _texts = texts(); begins the test");
        if !transcript.contains(&format!("\n{answer}")) {
            let gap = if transcript.is_empty() { "" } else { "\n" };
            write!(transcript, "{gap}$ trainer {line}\n{answer}").unwrap();
        }
    });
}

/// Returns whether a word differs from run to run: a checksum or a key.
fn is_arbitrary(word: &str) -> bool {
    let is_hex = word.chars().all(|c| c.is_ascii_hexdigit());
    is_hex && matches!(word.len(), 8 | 16 | 64)
}

fn is_number(word: &str) -> bool {
    let word = word.strip_prefix('-').unwrap_or(word);
    word.starts_with(|c: char| c.is_ascii_digit()) && word.parse::<f64>().is_ok()
}

/// Returns `text` with `#` for what differs from run to run. With `numbers`, also for numbers, and with columns that do not
/// depend on their width, because the last digits of a fit differ between machines. Quoted lines of files stay.
pub fn masked(text: &str, numbers: bool) -> String {
    let mut out = String::new();
    for line in text.split_inclusive('\n') {
        let mut rest = line;
        while let Some(first) = rest.chars().next() {
            let end = rest.find(|c: char| !(c.is_alphanumeric() || matches!(c, '_' | '.' | '-')));
            let word = rest[..end.unwrap_or(rest.len())].trim_end_matches(['.', '-']);
            let run = rest.len() - rest.trim_start_matches(first).len();
            let (length, shown) = if !numbers && line.contains(" | ") {
                (rest.len(), rest)
            } else if is_arbitrary(word) || numbers && is_number(word) {
                (word.len(), "#")
            } else if numbers && run > 1 && matches!(first, ' ' | '-') {
                (run, &rest[..2])
            } else {
                let length = word.len().max(first.len_utf8());
                (length, &rest[..length])
            };
            out += shown;
            rest = &rest[length..];
        }
    }
    out
}

/// Every text file belongs to a test that writes it.
#[test]
fn no_text_is_left_over() {
    for entry in walk(&folder()) {
        let module = entry
            .parent()
            .unwrap()
            .file_name()
            .unwrap()
            .to_str()
            .unwrap();
        let test = entry.file_stem().unwrap().to_str().unwrap();
        let source = folder().with_file_name(module).with_extension("rs");
        let source = std::fs::read_to_string(source).unwrap_or_default();
        let body = source
            .split(&format!("fn {test}()"))
            .nth(1)
            .unwrap_or_default();
        let body = body.split("\n}\n").next().unwrap();
        assert!(
            body.contains("= texts();"),
            "no test writes {}",
            entry.display()
        );
    }
}

fn walk(folder: &Path) -> Vec<PathBuf> {
    let modules = std::fs::read_dir(folder).unwrap();
    modules
        .flat_map(|module| std::fs::read_dir(module.unwrap().path()).unwrap())
        .map(|file| file.unwrap().path())
        .collect()
}
