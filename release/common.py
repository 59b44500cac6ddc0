"""What `release/build` and `release/try` share: commands, tools that are installed when they are missing, and hashes."""

import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TOOLS = ROOT / "target" / "tools"


class Absent(Exception):
    """This machine cannot make or try a part; the text says what is missing."""


class Failed(Exception):
    """A command failed, or a result is not what it must be."""


def headline(text):
    print(f"\n== {text}", flush=True)


def version():
    """The version of all crates of the workspace."""
    return tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]


def run(command, *, check=True, timeout=3600, **options):
    """Runs a command and returns it with its text. A command that fails ends the part with what it said."""
    command = [str(word) for word in command]
    options.setdefault("cwd", ROOT)
    options.setdefault("stdin", subprocess.DEVNULL)
    try:
        done = subprocess.run(command, text=True, capture_output=True, timeout=timeout, errors="replace", **options)
    except FileNotFoundError as error:
        raise Failed(f"{command[0]} is not installed") from error
    except subprocess.TimeoutExpired as error:
        raise Failed(f"{' '.join(command)}: no end after {timeout} s") from error
    if check and done.returncode != 0:
        said = (done.stdout + done.stderr).strip()[-3000:]
        raise Failed(f"{' '.join(command)}: exit code {done.returncode}\n{said}")
    return done


def printed(command, **options):
    return run(command, **options).stdout.strip()


def sha256(path):
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def megabytes(count):
    return f"{count / 1e6:.2f} MB"


def need(program, package):
    """Path of a program; installs its Debian packages when the program is missing and this user may."""
    found = shutil.which(program)
    if found:
        return found
    if shutil.which("apt-get"):
        sudo = [] if os.geteuid() == 0 else ["sudo", "-n"]
        install = [*sudo, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-o", "DPkg::Lock::Timeout=600"]
        install += ["install", "-q", "-y", "--no-install-recommends", *package.split()]
        print(f"+ {' '.join(install)}", flush=True)
        run(install, check=False, timeout=1200)
        found = shutil.which(program)
    if not found:
        raise Absent(f"{program} is not installed (Debian's package {package})")
    return found


def need_target(triple):
    """The standard library of a target; rustup installs it when it is missing."""
    library = Path(printed(["rustc", "--print", "target-libdir", "--target", triple]))
    if any(library.glob("libcore-*.rlib")):
        return
    if shutil.which("rustup"):
        print(f"+ rustup target add {triple}", flush=True)
        run(["rustup", "target", "add", triple], check=False, timeout=600)
    if not any(library.glob("libcore-*.rlib")):
        raise Absent(f"the compiler has no target {triple} (rustup target add {triple})")


def need_cargo_tool(name, pinned):
    """Path of a subcommand of cargo of this very version, in target/tools."""
    program = TOOLS / "bin" / name
    installed = run([program, name.removeprefix("cargo-"), "--version"], check=False) if program.exists() else None
    if installed is None or pinned not in installed.stdout:
        print(f"+ cargo install {name}@{pinned}", flush=True)
        # Not optimised: it runs for seconds.
        install = ["cargo", "install", "--quiet", "--locked", "--debug", "--force", "--root", TOOLS, f"{name}@{pinned}"]
        done = run(install, check=False, timeout=3600)
        if done.returncode != 0:
            raise Absent(f"{name} {pinned} could not be installed: {done.stderr.strip()[-300:]}")
    return program


def complain(text):
    print(text, file=sys.stderr, flush=True)
