//! The completions in the shells that load them, and the manual in the programs that show it.
//!
//! Each shell loads its script and completes: after every command, after `--`, and after every option with known values. The
//! offers are compared with the definition of the command line. Shells that are not installed are NOT RUN.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::process::{Command, Stdio};

use clap::CommandFactory;
use poegp_trainer::cli::Arguments;

use crate::program::Folder;

type Names = BTreeSet<String>;

/// Returns whether a program is installed; prints NOT RUN if not.
fn is_installed(program: &str, test: &str) -> bool {
    let found = Command::new("sh")
        .args(["-c", "command -v \"$1\"", "sh", program])
        .output()
        .is_ok_and(|output| output.status.success());
    if !found {
        // Shown even when the test harness captures output.
        let _ = writeln!(
            std::io::stderr(),
            "NOT RUN: {test}, because {program} is not installed"
        );
    }
    found
}

/// A typed line whose last word is to be completed, and the expected offers.
struct Question {
    line: String,
    expected: Names,
}

fn ask_of(command: &clap::Command, typed: &str, questions: &mut Vec<Question>) {
    let mut ask = |rest: &str, expected: Names| {
        questions.push(Question {
            line: format!("{typed} {rest}"),
            expected,
        });
    };
    let options = || command.get_arguments().filter(|a| !a.is_hide_set());
    let long = |a: &clap::Arg| a.get_long().map(|name| format!("--{name}"));
    ask("--", options().filter_map(long).collect());
    for option in options().filter(|a| a.get_action().takes_values()) {
        let values: Names = option
            .get_possible_values()
            .iter()
            .filter(|value| !value.is_hide_set())
            .map(|value| value.get_name().to_owned())
            .collect();
        if let Some(name) = long(option).filter(|_| !values.is_empty()) {
            ask(&format!("{name} "), values);
        }
    }
    let subcommands = || command.get_subcommands().filter(|c| !c.is_hide_set());
    let names: Names = subcommands().map(|c| c.get_name().to_owned()).collect();
    for start in names.iter().filter_map(|name| name.get(..3)) {
        let of_start = names.iter().filter(|name| name.starts_with(start));
        ask(start, of_start.cloned().collect());
    }
    for subcommand in subcommands().filter(|c| c.get_name() != "help") {
        let typed = format!("{typed} {}", subcommand.get_name());
        ask_of(subcommand, &typed, questions);
    }
}

/// Returns every question there is.
fn questions() -> Vec<Question> {
    let mut command = Arguments::command();
    command.build();
    let mut questions = Vec::new();
    ask_of(&command, "trainer", &mut questions);
    questions
}

/// Runs `program` in a folder with `script` and the typed lines in `lines`. It writes to `answers`, where the offers for each
/// line follow `> line`. A shell that completes only at a terminal gets one.
fn answers(
    shell: &str,
    files: &[(&str, &str)],
    arguments: &[&str],
    questions: &[Question],
) -> BTreeMap<String, Names> {
    let folder = Folder::new();
    folder
        .run(&format!("completions {shell} --out _trainer"))
        .ok();
    let lines: Vec<&str> = questions.iter().map(|q| q.line.as_str()).collect();
    folder.write("lines", lines.join("\n") + "\n");
    for (name, text) in files {
        folder.write(name, text);
    }
    let mut command = Command::new("timeout");
    command.args(["120"]).args(arguments);
    let path = folder.path("");
    let ended = command
        .current_dir(&path)
        .env("ZDOTDIR", &path)
        .env("HOME", &path)
        .env("TERM", "dumb")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(ended.status.success(), "{shell}: {ended:?}");
    let mut answers = BTreeMap::new();
    let mut line = String::new();
    for answer in folder.text("answers").lines() {
        match answer.strip_prefix("> ") {
            Some(next) => {
                line = next.to_owned();
                answers.insert(line.clone(), Names::new());
            }
            None => drop(answers.get_mut(&line).unwrap().insert(answer.to_owned())),
        }
    }
    answers
}

#[track_caller]
fn compare(shell: &str, questions: &[Question], answers: &BTreeMap<String, Names>) {
    // Two questions for each of more than 30 commands; the script for elvish does not complete values.
    assert!(questions.len() > 60, "{}", questions.len());
    for Question { line, expected } in questions {
        let found = answers.get(line);
        assert_eq!(found, Some(expected), "{shell}: {line}");
    }
}

#[test]
fn bash_completes_commands_options_and_values() {
    if !is_installed("bash", "completions in bash") {
        return;
    }
    // Does what readline does at a TAB: calls the function that `complete` has for the command.
    let script = r#"
source ./_trainer
[[ $(complete -p trainer) =~ -F\ ([^ ]+) ]]
while IFS= read -r line; do
    read -ra COMP_WORDS <<<"$line"
    [[ $line != *' ' ]] || COMP_WORDS+=('')
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMP_LINE=$line COMP_POINT=${#line} COMPREPLY=()
    "${BASH_REMATCH[1]}" trainer "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
    printf '%s\n' "> $line" "${COMPREPLY[@]}"
done <lines >answers
"#;
    let questions = questions();
    let bash = ["bash", "--norc", "script"];
    let answers = answers("bash", &[("script", script)], &bash, &questions);
    compare("bash", &questions, &answers);
}

#[test]
fn zsh_completes_commands_options_and_values() {
    if !is_installed("zsh", "completions in zsh") || !is_installed("script", "completions in zsh") {
        return;
    }
    // A terminal, the line editor and its completion as users have them. A replaced `compadd` receives the offers.
    let rc = r#"
fpath=($PWD $fpath)
autoload -Uz compinit && compinit -D -u
compadd() {
    if [[ " ${@[1,(i)(-|--)]} " != *' -'[OAD]' '* ]]; then
        local -a offered
        builtin compadd -O offered "$@"
        (( $#offered )) && print -rl -- $offered >>answers
    fi
    builtin compadd "$@"
}
zle-line-init() {
    local line
    while IFS= read -r line; do
        BUFFER=$line CURSOR=$#line
        print -r -- "> $line" >>answers
        zle complete-word
    done <lines
    BUFFER=exit
    zle accept-line
}
zle -N zle-line-init
"#;
    let questions = questions();
    let zsh = ["script", "-qec", "zsh -d -i", "/dev/null"];
    let answers = answers("zsh", &[(".zshrc", rc)], &zsh, &questions);
    compare("zsh", &questions, &answers);
}

#[test]
fn fish_completes_commands_options_and_values() {
    if !is_installed("fish", "completions in fish") {
        return;
    }
    let script = "
source ./_trainer
while read -l line
    echo \"> $line\"
    complete -C $line | string split -f1 \\t
end <lines >answers
";
    let questions = questions();
    let fish = ["fish", "--no-config", "script"];
    let answers = answers("fish", &[("script", script)], &fish, &questions);
    compare("fish", &questions, &answers);
}

/// The script for elvish does not complete values of options.
#[test]
fn elvish_completes_commands_and_options() {
    if !is_installed("elvish", "completions in elvish")
        || !is_installed("script", "completions in elvish")
    {
        return;
    }
    // The completer returns everything; elvish offers what begins with the last word.
    let rc = r#"
use str
eval (slurp <./_trainer)
from-lines <lines | each {|line|
    var words = [(str:split ' ' $line)]
    echo '> '$line
    $edit:completion:arg-completer[trainer] $@words | each {|offered|
        if (str:has-prefix $offered[stem] $words[-1]) { echo $offered[stem] }
    }
} >answers
exit
"#;
    let mut questions = questions();
    questions.retain(|question| !question.line.ends_with(' '));
    let elvish = ["script", "-qec", "elvish -rc rc.elv", "/dev/null"];
    let answers = answers("elvish", &[("rc.elv", rc)], &elvish, &questions);
    compare("elvish", &questions, &answers);
}

/// Returns the warnings of `program` about the manual pages.
fn complaints(program: &[&str], folder: &Folder) -> Vec<String> {
    let names = folder.names();
    let pages = names.iter().filter(|name| name.ends_with(".1"));
    let output = Command::new(program[0])
        .args(&program[1..])
        .args(pages)
        .current_dir(folder.path(""))
        .output()
        .unwrap();
    let text = [output.stderr, output.stdout].concat();
    let text = String::from_utf8(text).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn the_manual_is_read_without_a_warning() {
    let folder = Folder::new();
    let files = folder.run("manual --out man --json -").ok().json();
    for file in files["files"].as_array().unwrap() {
        let name = file.as_str().unwrap();
        folder.write(name.rsplit('/').next().unwrap(), folder.read(name));
    }
    if is_installed("groff", "the manual in groff") {
        let found = complaints(&["groff", "-man", "-K", "utf8", "-ww", "-z"], &folder);
        assert!(found.is_empty(), "{found:#?}");
    }
    if is_installed("mandoc", "the manual in mandoc") {
        // clap_mangen puts line breaks around the blank line above a list of values; these two warnings are ignored.
        let harmless = ["br before sp", "br after sp"];
        let mut found = complaints(&["mandoc", "-T", "lint", "-W", "warning"], &folder);
        found.retain(|line| !harmless.iter().any(|end| line.ends_with(end)));
        assert!(found.is_empty(), "{found:#?}");
    }
}
