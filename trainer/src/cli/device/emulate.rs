//! `trainer device emulate`.

use crate::cli::device::args::Emulate;
use crate::cli::failure::Failure;

#[cfg(not(unix))]
pub fn run(_: &Emulate) -> Result<(), Failure> {
    Err(Failure::Usage(
        "the emulator needs a Unix system: QEMU inherits its sockets".to_owned(),
    ))
}

#[cfg(unix)]
pub use unix::run;

#[cfg(unix)]
mod unix {
    use std::path::PathBuf;
    use std::{fs, io};

    use serde_json::json;

    use super::{Emulate, Failure};
    use crate::cli::output::kind::Kind;
    use crate::cli::output::{check_outputs, write_summary};
    use crate::cli::terminal::print::Printer;
    use crate::device::emulator::{Clock, Listener, Machine, serve};
    use crate::device::port::Address;

    pub fn run(a: &Emulate) -> Result<(), Failure> {
        let outputs = [
            (a.json.as_deref(), Kind::Json),
            (a.flash_image.as_deref(), Kind::FlashImage),
        ];
        check_outputs(&outputs, &[&a.elf])?;
        let (board, elf) = (a.board, &a.elf);
        if !elf.is_file() {
            return Err(Failure::Usage(format!(
                "--elf {}: no such file\nhelp: in a clone of the repository, `cargo run --release -p poegp-tests \
                 --example firmware FILE` builds an image",
                elf.display()
            )));
        }
        let image = fs::read(elf)
            .map_err(|error| Failure::Usage(format!("--elf {}: {error}", elf.display())))?;
        if let Some(other) = board.other_in(&image) {
            return Err(Failure::Usage(format!(
                "--elf {}: this firmware is for the board {}, and {} is to be emulated\nhelp: take --board {}",
                elf.display(),
                other.name(),
                board.name(),
                other.name()
            )));
        }
        let link = listen(a.listen.as_ref(), "link")?;
        let log = listen(a.log.as_ref(), "log")?;
        let (port, log_port) = (link.address().to_string(), log.address().to_string());
        let report = Printer::for_outputs(&[a.json.as_deref()]);
        report.line(format_args!("port      {port}"));
        report.line(format_args!("log       {log_port}"));
        report.line(format_args!("firmware  {}", elf.display()));
        report.line(format_args!("{} runs until Ctrl-C.", board.name()));
        let summary = json!({ "board": board.name(), "port": port, "log": log_port, "elf": elf });
        write_summary(a.json.as_deref(), summary)?;
        let machine = Machine {
            board,
            elf,
            clock: if a.deterministic_clock {
                Clock::Counting
            } else {
                Clock::Real
            },
            flash_image: a.flash_image.as_deref(),
        };
        Err(Failure::Usage(serve(&machine, link, log).to_string()))
    }

    fn listen(asked: Option<&Address>, name: &str) -> Result<Listener, Failure> {
        let failed = |location: String, error: io::Error| {
            let why = match error.kind() {
                io::ErrorKind::Unsupported => "expected unix:PATH or tcp:HOST:PORT".to_owned(),
                _ => error.to_string(),
            };
            Failure::Usage(format!("cannot listen on {location}: {why}"))
        };
        let address = match asked {
            Some(address) => address.clone(),
            None => {
                let folder =
                    own_folder().map_err(|e| failed("a temporary folder".to_owned(), e))?;
                Address::Unix(folder.join(name))
            }
        };
        Listener::at(&address).map_err(|error| failed(address.to_string(), error))
    }

    const PREFIX: &str = "poegp-emulated-";

    /// Creates a folder for the sockets, named after this process, which QEMU then replaces. No process remains to remove
    /// the folder in the end, so folders of emulations that have ended are removed first.
    fn own_folder() -> io::Result<PathBuf> {
        let parent = std::env::temp_dir();
        for entry in fs::read_dir(&parent)?.flatten() {
            let folder = entry.path();
            let name = entry.file_name();
            if name.to_string_lossy().starts_with(PREFIX) && is_left_over(&folder.join("link")) {
                let _ = fs::remove_dir_all(folder);
            }
        }
        let folder = parent.join(format!("{PREFIX}{}", std::process::id()));
        match fs::create_dir(&folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
            _ => Ok(folder),
        }
    }

    fn is_left_over(socket: &std::path::Path) -> bool {
        std::os::unix::net::UnixStream::connect(socket)
            .is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused)
    }
}
