//! `trainer completions` and `trainer manual`: what shells and `man` want to know, made from the command line itself.

use std::path::{Path, PathBuf};

use clap::Args;
use clap_complete::Shell;
use serde_json::json;

use crate::cli::report::Report;
use crate::cli::simulate::make_folder;
use crate::cli::{Failure, check_outputs, command, facts_text, write_outputs};

/// `trainer completions`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    trainer completions bash --out ~/.local/share/bash-completion/completions/trainer\n  \
    trainer completions zsh --out ~/.zfunc/_trainer   (with ~/.zfunc in fpath)\n  \
    trainer completions fish --out ~/.config/fish/completions/trainer.fish\n  \
    trainer completions powershell   (add its output to $PROFILE)")]
pub struct Completions {
    /// Which shell.
    #[arg(value_enum)]
    pub shell: Shell,
    /// Where the script goes (`-`: standard output).
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub out: PathBuf,
}

/// `trainer manual`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  trainer manual --out man1\n  man man1/trainer-calibrate.1")]
pub struct Manual {
    /// Folder to write into, created if it does not exist (its parent must): trainer.1, trainer-calibrate.1 and so on.
    #[arg(long, value_name = "FOLDER")]
    pub out: PathBuf,
    /// The names of the files as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub fn completions(a: &Completions) -> Result<(), Failure> {
    check_outputs(&[Some(&a.out)], &[])?;
    let mut script = Vec::new();
    clap_complete::generate(a.shell, &mut command(), "trainer", &mut script);
    write_outputs(&[(&a.out, &script)])
}

pub fn manual(a: &Manual) -> Result<(), Failure> {
    check_outputs(&[a.json.as_deref()], &[])?;
    make_folder(&a.out)?;
    let mut root = command().disable_help_subcommand(true);
    root.build();
    let mut pages = Vec::new();
    collect(&root, &a.out, &mut pages)
        .map_err(|error| Failure::Usage(format!("a manual page cannot be made: {error}")))?;
    let names: Vec<String> = pages
        .iter()
        .map(|(path, _)| path.display().to_string())
        .collect();
    let facts = facts_text(json!({ "files": names }))?;
    let mut files: Vec<(&Path, &[u8])> = pages
        .iter()
        .map(|(path, page)| (path.as_path(), page.as_slice()))
        .collect();
    files.extend(a.json.as_deref().map(|path| (path, facts.as_bytes())));
    write_outputs(&files)?;
    let count = pages.len();
    Report::beside(&[a.json.as_deref()]).line(format_args!(
        "Wrote {count} manual pages into {}: man {}",
        a.out.display(),
        names[0]
    ));
    Ok(())
}

/// The page of a command and those of its subcommands.
fn collect(
    command: &clap::Command,
    folder: &Path,
    pages: &mut Vec<(PathBuf, Vec<u8>)>,
) -> std::io::Result<()> {
    let man = clap_mangen::Man::new(command.clone());
    let mut page = Vec::new();
    man.render(&mut page)?;
    pages.push((folder.join(man.get_filename()), page));
    for subcommand in command.get_subcommands() {
        collect(subcommand, folder, pages)?;
    }
    Ok(())
}
