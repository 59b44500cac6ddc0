//! Words that identifiers and texts for users must not contain, because the field has a plainer one for each.

use super::tokens::{Kind, Token, files, sources, tokens, without_tests, workspace};

const FOLDERS: [&str; 7] = [
    "protocol/src",
    "runtime/src",
    "runtime/capi/src",
    "calibration/src",
    "trainer/src",
    "firmware/src",
    "python/src",
];

/// Forbidden in texts: in string literals and in the documentation of the command line, which `--help` shows.
const TEXTS: [&str; 10] = [
    "told",
    "untold",
    "tell",
    "words",
    "facts",
    "anew",
    "likewise",
    "the same of",
    "whoever",
    "input that is none",
];

/// Forbidden in documentation as well.
const PROSE: [&str; 7] = [
    "told",
    "untold",
    "anew",
    "likewise",
    "the same of",
    "whoever",
    "input that is none",
];

/// Forbidden as a part of an identifier. A `cell` is a robot's; files and programs have none.
const PARTS: [&str; 10] = [
    "told", "untold", "tell", "words", "place", "facts", "anew", "likewise", "whoever", "cell",
];

/// Names from libraries, which are allowed.
const FOREIGN: [&str; 9] = [
    "Cell",
    "RefCell",
    "UnsafeCell",
    "StaticCell",
    "ConstStaticCell",
    "static_cell",
    "self_cell",
    "worksheet_cells_reader",
    "next_cell",
];

/// Allowed names that count words of four bytes.
const STORAGE: [&str; 5] = [
    "words_for",
    "row_words",
    "landmark_words",
    "variance_words",
    "capacity_words",
];

/// Returns the parts of an identifier, in lower case.
fn parts(word: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut was_lower = false;
    for c in word.chars() {
        if c == '_' || c.is_uppercase() && was_lower {
            parts.push(String::new());
        }
        was_lower = c.is_lowercase();
        if c != '_' {
            parts.last_mut().unwrap().extend(c.to_lowercase());
        }
    }
    parts
}

/// Returns whether `text` contains `word`, or its plural, as a whole word.
fn has(text: &str, word: &str) -> bool {
    let text = text.to_lowercase();
    let letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    text.match_indices(word).any(|(at, _)| {
        let after = text[at + word.len()..].trim_start_matches('s');
        !letter(text[..at].chars().next_back()) && !letter(after.chars().next())
    })
}

/// Returns the forbidden words of a source, each with its place.
fn forbidden(path: &str, tokens: &[Token]) -> Vec<(&'static str, String)> {
    // In these sources, `words` are storage of four bytes.
    let counts_storage = !path.starts_with("trainer") && !path.starts_with("calibration")
        || path.ends_with("device_cost.rs");
    let is_library = |i: usize| {
        i > 1 && tokens[i - 1].is("::") && (tokens[i - 2].is("core") || tokens[i - 2].is("std"))
    };
    let mut out = Vec::new();
    for (i, token) in tokens.iter().enumerate() {
        let found: Vec<&'static str> = match token.kind {
            Kind::Word if FOREIGN.contains(&token.text.as_str()) || is_library(i) => continue,
            Kind::Word if token.text == "Found" => vec!["Found"],
            Kind::Word => {
                let parts = parts(&token.text);
                let has = |word: &&str| {
                    let is_part = parts
                        .iter()
                        .any(|part| part == word || part.strip_suffix('s') == Some(word));
                    let is_storage = counts_storage || STORAGE.contains(&token.text.as_str());
                    // `in_place` is an established term.
                    let in_place = *word == "place" && token.text.contains("_in_place");
                    is_part && !(*word == "words" && is_storage) && !in_place
                };
                PARTS.into_iter().filter(has).collect()
            }
            Kind::Text => TEXTS
                .into_iter()
                .filter(|word| has(&token.text, word))
                .collect(),
            Kind::Doc if path.starts_with("trainer/src/cli") => TEXTS
                .into_iter()
                .filter(|word| has(&token.text, word))
                .collect(),
            Kind::Doc => PROSE
                .into_iter()
                .filter(|word| has(&token.text, word))
                .collect(),
            Kind::Symbol => continue,
        };
        for word in found {
            let place = format!(
                "{path}:{}: {:.60}",
                token.line,
                token.text.replace('\n', " ")
            );
            out.push((word, place));
        }
    }
    out
}

#[test]
fn no_word_comes_back() {
    let mut all = Vec::new();
    for folder in FOLDERS {
        for file in sources(&workspace(folder)) {
            let path = file
                .strip_prefix(workspace(""))
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned();
            if !path.contains("/tests/") && !path.ends_with("/tests.rs") {
                let source = std::fs::read_to_string(&file).unwrap();
                all.extend(forbidden(&path, &without_tests(&tokens(&source)).0));
            }
        }
    }
    for word in PARTS.iter().chain(&TEXTS).chain(&["Found"]) {
        let places: Vec<&String> = all
            .iter()
            .filter(|(w, _)| w == word)
            .map(|(_, place)| place)
            .collect();
        assert!(
            places.is_empty(),
            "`{word}` stands {} times: {places:#?}",
            places.len()
        );
    }
}

#[test]
fn no_word_comes_back_in_documents() {
    let top = [
        "README",
        "ARCHITECTURE",
        "CONTRIBUTING",
        "SECURITY",
        "CHANGELOG",
    ];
    let mut pages = files(&workspace("docs"), "md");
    pages.extend(top.map(|name| workspace(&format!("{name}.md"))));
    let mut found = Vec::new();
    for page in pages {
        let text = std::fs::read_to_string(&page).unwrap();
        for (number, line) in text.lines().enumerate() {
            let words = PROSE.into_iter().filter(|word| has(line, word));
            found.extend(words.map(|word| format!("{}:{}: {word}", page.display(), number + 1)));
        }
    }
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn planted_words_are_seen() {
    let source = "/// It is told.\nfn cells_of(told: &str) -> Found { \"whoever has it anew\"; RefCell; cell::Cell; words_for }\n\
                  struct MarketPlace; // facts\nconst RETOLD: &str = \"cellar, retelling, a password\";\n\
                  #[cfg(test)]\nmod tests { fn facts() {} }";
    let source = without_tests(&tokens(source)).0;
    let words = |path: &str| -> Vec<&str> {
        forbidden(path, &source)
            .iter()
            .map(|(word, _)| *word)
            .collect()
    };
    let named = ["cell", "told", "Found", "anew", "whoever", "cell", "place"];
    let in_prose = [&["told"][..], &named].concat();
    assert_eq!(words("runtime/src/a.rs"), in_prose);
    assert_eq!(words("trainer/src/cli/a.rs"), in_prose);
}
