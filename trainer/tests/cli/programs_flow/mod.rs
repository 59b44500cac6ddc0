//! `trainer correct` of robot programs: a target is corrected only if tool, frame, payload, displacement and the target itself
//! are certain on every path through the program.

mod job_and_listing;
mod krl;
mod krl_data;
mod rapid;
mod rapid_data;
mod urscript;
mod val3;

use serde_json::Value;

use crate::program::Folder;

/// Corrects a program. Returns the number of corrected targets, and the reasons for those that are left.
fn run(folder: &Folder, name: &str, text: &str, rest: &str) -> (u64, String) {
    folder.write(name, text);
    let rest = if rest.is_empty() {
        "--payload-kg 2.5"
    } else {
        rest
    };
    let line =
        format!("correct elas.blob {name} --frames frames.toml {rest} --json - --out out_{name}");
    let outcome = folder.run(&line);
    assert!(matches!(outcome.code, Some(0 | 1)), "{text}\n{outcome:#?}");
    let document = outcome.json();
    let reason = |left: &Value| left.to_string();
    let left: Vec<String> = document["left"]
        .as_array()
        .unwrap()
        .iter()
        .map(reason)
        .collect();
    (document["targets"].as_u64().unwrap(), left.join("\n"))
}

fn check(
    folder: &Folder,
    cases: &[(impl AsRef<str>, u64, &str)],
    name: &str,
    rest: &str,
    whole: impl Fn(&str) -> String,
) {
    for (part, corrected, reason) in cases {
        let part = part.as_ref();
        let (targets, left) = run(folder, name, &whole(part), rest);
        assert_eq!(targets, *corrected, "{part}\n{left}");
        match reason.is_empty() {
            true => assert_eq!(left, "", "{part}"),
            false => assert!(left.contains(reason), "{part}\n{left}"),
        }
    }
}

/// Corrects `text` and checks the number of corrected targets and the reason for those that are left. Where none is corrected, the
/// command fails, and `corrected` is 0.
fn check_whole(folder: &Folder, name: &str, text: &str, corrected: u64, reason: &str) {
    folder.write(name, text);
    let outcome = folder.run(&format!(
        "correct elas.blob {name} --payload-kg 2.5 --frames frames.toml --json - --out out_{name}"
    ));
    let said = outcome.stdout.clone() + &outcome.stderr;
    assert!(said.contains(reason), "{text}\n{outcome:#?}");
    if corrected > 0 {
        assert_eq!(
            outcome.json()["targets"].as_u64(),
            Some(corrected),
            "{text}\n{outcome:#?}"
        );
    }
}
