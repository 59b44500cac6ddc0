//! `trainer completions`, `trainer manual` and the command reference, all generated from the command line itself.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use clap_complete::Shell;
use poegp_calibration::model::Method;
use serde_json::json;

use crate::cli::args;
use crate::cli::failure::Failure;
use crate::cli::inputs::now;
use crate::cli::output::kind::{Kind, check_kind};
use crate::cli::output::make_folder;
use crate::cli::output::{check_outputs, summary_text, write_outputs};
use crate::cli::terminal::print::Printer;

/// Last paragraph of every help text.
pub const EXIT_CODES: &str = "Exit codes: 0 done, 1 a quality bound was not met, a signature does not match or an \
output could not be written, \
    2 usage, input or device error, 3 data refused, 130 stopped by Ctrl-C (no file is left half-written).";

/// `trainer completions`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    trainer completions bash --out ~/.local/share/bash-completion/completions/trainer\n  \
    trainer completions zsh --out ~/.zfunc/_trainer   (with ~/.zfunc in fpath)\n  \
    trainer completions fish --out ~/.config/fish/completions/trainer.fish\n  \
    trainer completions elvish   (in rc.elv: eval (trainer completions elvish | slurp))")]
pub struct Completions {
    /// Shell.
    #[arg(value_enum)]
    pub shell: CompletedShell,
    /// Write the script (`-`: standard output).
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub out: PathBuf,
}

/// The shells in which the tests load the scripts (`trainer/tests/cli/shells.rs`).
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CompletedShell {
    Bash,
    Elvish,
    Fish,
    Zsh,
}

impl From<CompletedShell> for Shell {
    fn from(shell: CompletedShell) -> Self {
        match shell {
            CompletedShell::Bash => Self::Bash,
            CompletedShell::Elvish => Self::Elvish,
            CompletedShell::Fish => Self::Fish,
            CompletedShell::Zsh => Self::Zsh,
        }
    }
}

/// `trainer manual`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  trainer manual --out man1\n  man man1/trainer-calibrate.1")]
pub struct Manual {
    /// Folder to write into, created if it does not exist (its parent must): trainer.1, trainer-calibrate.1 and so on.
    #[arg(long, value_name = "FOLDER")]
    pub out: PathBuf,
    /// Write the file names as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn completions(a: &Completions, mut command: clap::Command) -> Result<(), Failure> {
    check_outputs(&[(Some(&a.out), Kind::Completions)], &[])?;
    let mut script = Vec::new();
    clap_complete::generate(Shell::from(a.shell), &mut command, "trainer", &mut script);
    write_outputs(&[(&a.out, &script)])
}

pub fn manual(a: &Manual, command: clap::Command) -> Result<(), Failure> {
    check_outputs(&[(a.json.as_deref(), Kind::Json)], &[])?;
    let _folder = make_folder(&a.out)?;
    let mut root = command.disable_help_subcommand(true);
    root.build();
    let mut pages = Vec::new();
    collect(&root, &a.out, &mut pages)
        .map_err(|error| Failure::Usage(format!("a manual page cannot be made: {error}")))?;
    for (path, _) in &pages {
        check_kind(path, Kind::ManualPage)?;
    }
    let names: Vec<String> = pages
        .iter()
        .map(|(path, _)| path.display().to_string())
        .collect();
    let summary = summary_text(json!({ "files": names }))?;
    let mut files: Vec<(&Path, &[u8])> = pages
        .iter()
        .map(|(path, page)| (path.as_path(), page.as_slice()))
        .collect();
    files.extend(a.json.as_deref().map(|path| (path, summary.as_bytes())));
    write_outputs(&files)?;
    let count = pages.len();
    Printer::for_outputs(&[a.json.as_deref()]).line(format_args!(
        "Wrote {count} manual pages into {}: man {}",
        a.out.display(),
        names[0]
    ));
    Ok(())
}

/// Returns the text of `docs/reference/commands.md`: every command with its options, from the same text as `--help`.
/// Options that several commands share are described once.
pub fn command_reference(command: clap::Command) -> String {
    let mut root = command.disable_help_subcommand(true);
    root.build();
    let mut leaves = Vec::new();
    collect_leaves(&root, &mut leaves);
    let mut uses: BTreeMap<String, usize> = BTreeMap::new();
    for text in leaves.iter().flat_map(|leaf| options(leaf)) {
        *uses.entry(text).or_default() += 1;
    }
    let shared = |text: &String| uses[text] > 1;
    let mut page = String::from(
        "# Commands\n\nGenerated from the command line by `POEGP_BLESS=1 cargo test -p poegp-trainer --test documents \
         command_reference`.\n\n",
    );
    page += &format!(
        "{EXIT_CODES}\n\n## Shared options\n\nEvery command also accepts `--quiet` and `--help`.\n\n"
    );
    for text in uses.keys().filter(|text| shared(text)) {
        page += &format!("- {text}\n");
    }
    page += "\n## Methods\n\n";
    for value in args::methods() {
        page += &format!("- `{}`: {}\n", value.get_name(), sentence(value.get_help()));
    }
    for leaf in leaves {
        let usage = leaf.clone().render_usage().to_string();
        let usage = usage
            .trim_start_matches("Usage: ")
            .replace("\n       ", "\n");
        let name = leaf.get_bin_name().unwrap_or(leaf.get_name());
        page += &format!("\n## {name}\n\n{}\n", sentence(leaf.get_about()));
        page += &format!("\n```text\n{usage}\n```\n\n");
        let (common, own): (Vec<_>, Vec<_>) = options(leaf).into_iter().partition(shared);
        for text in own {
            page += &format!("- {text}\n");
        }
        if !common.is_empty() {
            let names = common
                .iter()
                .filter_map(|text| text.split(['`', ' ']).nth(1));
            let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
            page += &format!("- Shared: {}\n", names.join(", "));
        }
    }
    page
}

fn collect_leaves<'a>(parent: &'a clap::Command, leaves: &mut Vec<&'a clap::Command>) {
    for command in parent.get_subcommands() {
        if command.has_subcommands() {
            collect_leaves(command, leaves);
        } else {
            leaves.push(command);
        }
    }
}

/// Describes each option of a command, except those that all commands have.
fn options(command: &clap::Command) -> Vec<String> {
    let own = command.get_arguments();
    own.filter(|a| !a.is_global_set() && !a.is_hide_set() && a.get_id() != "help")
        .map(option)
        .collect()
}

/// Describes an option: name, meaning, values and default.
fn option(argument: &clap::Arg) -> String {
    let mut line = format!("`{argument}`: {}", sentence(argument.get_help()));
    let possible = argument.get_possible_values();
    let possible: &[PossibleValue] = match argument.get_action().takes_values() {
        true => &possible,
        false => &[],
    };
    let is_method = |value: &&PossibleValue| value.get_name().parse::<Method>().is_ok();
    let (methods, others): (Vec<_>, Vec<_>) = possible.iter().partition(is_method);
    let mut values: Vec<String> = others.into_iter().map(possible_value).collect();
    if !methods.is_empty() {
        values.push("the [methods](#methods)".to_owned());
    }

    if !values.is_empty() {
        line += &format!(" Values: {}.", values.join(", "));
    }
    let defaults: Vec<_> = argument
        .get_default_values()
        .iter()
        .map(|value| value.to_string_lossy())
        .filter(|value| !value.is_empty())
        .collect();
    let is_stated = argument.is_hide_default_value_set();
    if !defaults.is_empty() && argument.get_action().takes_values() && !is_stated {
        line += &format!(" Default: `{}`.", defaults.join(","));
    }
    line
}

/// Describes a value of an option.
fn possible_value(value: &PossibleValue) -> String {
    match value.get_help() {
        Some(help) => {
            let help = sentence(Some(help));
            format!("`{}` ({})", value.get_name(), help.trim_end_matches('.'))
        }
        None => format!("`{}`", value.get_name()),
    }
}

/// Joins a text into one line that ends with a full stop.
fn sentence(text: Option<&clap::builder::StyledStr>) -> String {
    let text = text.map(ToString::to_string).unwrap_or_default();
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.trim_end_matches('.').to_owned() + "."
}

/// Renders the manual page of a command and those of its subcommands.
fn collect(
    command: &clap::Command,
    folder: &Path,
    pages: &mut Vec<(PathBuf, Vec<u8>)>,
) -> std::io::Result<()> {
    let man = clap_mangen::Man::new(command.clone())
        .date(now().date().to_string())
        .source(concat!("trainer ", env!("CARGO_PKG_VERSION")))
        .manual("poegp");
    let mut page = Vec::new();
    man.render(&mut page)?;
    let page =
        String::from_utf8_lossy(&page).replace("\n.SH EXTRA\n", "\n.SH EXAMPLES AND EXIT CODES\n");
    pages.push((folder.join(man.get_filename()), page.into_bytes()));
    for subcommand in command.get_subcommands() {
        collect(subcommand, folder, pages)?;
    }
    Ok(())
}
