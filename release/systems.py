"""Where the program will live: each system puts an artefact there, runs commands in a folder of its own, and cleans up.

All commands name files relative to `folder`, which is a folder of this machine."""

import os
import shutil
import tempfile
import time
from pathlib import Path

from common import ROOT, Absent, Failed, need, run

# Day that stands in every model.
ENVIRONMENT = {"SOURCE_DATE_EPOCH": "1780000000", "NO_COLOR": "1"}


def need_root():
    if os.geteuid() != 0:
        raise Absent("it needs root: the root of the file system is changed")


class System:
    """The common part."""

    # How many times as slow as this machine, roughly: long commands are left out beyond 10.
    slowness = 1
    # Whether the program is a descendant of this process.
    own_process = True
    # Whether Ctrl-C is a key of a terminal, and not a signal.
    by_terminal = False

    def __init__(self, work, files):
        self.work, self.files = work, files
        self.folder = work
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)

    def environment(self):
        return os.environ | ENVIRONMENT

    def run(self, *arguments, check=True, timeout=1800):
        """Runs the program with these arguments."""
        return run([*self.command(), *arguments], cwd=self.folder, env=self.environment(), check=check, timeout=timeout)

    def leave(self):
        """Takes everything away again."""
        shutil.rmtree(self.work, ignore_errors=True)


class EmptyRoot(System):
    """A folder that is the root of the file system, with the program and what the trial puts there."""

    title = "empty root file system"

    def set_up(self):
        need_root()
        shutil.copy2(self.files[0], self.work / "trainer")

    def command(self):
        return ["chroot", self.work, "/trainer"]


class EmulatedRoot(EmptyRoot):
    """The same under QEMU."""

    title = "empty root file system, qemu-user"
    slowness = 20

    def set_up(self):
        super().set_up()
        shutil.copy2(need("qemu-aarch64-static", "qemu-user-static"), self.work / "qemu")

    def command(self):
        return ["chroot", self.work, "/qemu", "/trainer"]


class Debian(System):
    """A fresh Debian, into which the package is installed."""

    title = "fresh Debian (debootstrap)"
    # What Debian itself writes when it installs and removes any package.
    ITS_OWN = ("/var/lib/dpkg/", "/var/lib/apt/", "/var/log/", "/var/cache/", "/root/work")

    def set_up(self):
        need_root()
        tool = need("debootstrap", "debootstrap")
        # Unpacked once; every trial gets a copy that nobody has used.
        fresh = ROOT / "target/release-try/debian.tar"
        if not fresh.exists():
            shutil.rmtree(self.work)
            run([tool, "--variant=minbase", "stable", self.work], timeout=1800)
            run(["tar", "-C", self.work, "-cf", f"{fresh}.new", "."])
            os.replace(f"{fresh}.new", fresh)
        else:
            run(["tar", "-C", self.work, "-xpf", fresh])
        self.folder = self.work / "root/work"
        self.folder.mkdir()
        self.before = self.listed()
        self.started = time.monotonic()
        package = next(file for file in self.files if file.name.endswith("amd64.deb"))
        shutil.copy2(package, self.work / "poegp.deb")
        self.chroot("apt-get", "install", "-q", "-y", "/poegp.deb")
        (self.work / "poegp.deb").unlink()

    def chroot(self, *arguments):
        environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "DEBIAN_FRONTEND": "noninteractive"}
        return run(["chroot", self.work, *arguments], env=environment)

    def listed(self):
        skipped = tuple(str(self.work) + name for name in ("/proc", "/sys", "/dev", *self.ITS_OWN))
        files = (str(path) for path in self.work.rglob("*"))
        return {file.removeprefix(str(self.work)) for file in files if not file.startswith(skipped)}

    def command(self):
        return ["chroot", self.work, "env", "-C", "/root/work", "PATH=/usr/bin:/bin", "trainer"]

    def check_itself(self):
        """The files of the package; nothing of it stays after removal."""
        installed = self.listed() - self.before
        for file in (
            "/usr/bin/trainer",
            "/usr/share/man/man1/trainer.1.gz",
            "/usr/share/man/man1/trainer-calibrate.1.gz",
            "/usr/share/bash-completion/completions/trainer",
            "/usr/share/zsh/vendor-completions/_trainer",
            "/usr/share/fish/vendor_completions.d/trainer.fish",
            "/usr/share/poegp/robots/ur10.toml",
            "/usr/share/doc/poegp/examples/irb4400_paper_s0_train.csv",
            "/usr/share/doc/poegp/copyright",
        ):
            if file not in installed and not (self.work / file[1:]).exists():
                raise Failed(f"the package has no {file}")
        self.run("calibrate", "--robot", "/usr/share/poegp/robots/abb-irb4400-serial.toml", "--method", "poe",
                 "/usr/share/doc/poegp/examples/irb4400_paper_s0_train.csv", "--out", "own.blob")  # fmt: skip
        self.chroot("apt-get", "purge", "-q", "-y", "poegp")
        left = sorted(self.listed() - self.before)
        if left:
            raise Failed(f"the package leaves {', '.join(left[:5])}")
        return "removed"


class Container(System):
    """podman, with an image that is built for this trial and removed after it."""

    title = "podman"
    own_process = False

    def set_up(self):
        # podman refuses long paths.
        self.storage = tempfile.mkdtemp(prefix="poegp-")
        self.podman = [need("podman", "podman runc"), "--cgroup-manager=cgroupfs", f"--root={self.storage}/storage", f"--runroot={self.storage}/run"]
        plain, folder = self.podman, self.files[0].parent
        run([*plain, "build", "--tag", "poegp-trial", "--file", self.files[0], folder])
        # podman's own choice of a runtime needs the second version of control groups.
        for choice in ([], ["--runtime=runc"]):
            self.podman = [*plain, *choice]
            done = run([*self.command(), "--version"], env=self.environment(), check=False)
            if done.returncode == 0:
                return
        raise Absent(f"podman does not run here: {done.stderr.strip().splitlines()[-1]}")

    def command(self):
        names = [word for name in ENVIRONMENT for word in ("--env", name)]
        # podman would raise these limits, which not every root may do.
        limits = ["--ulimit=nofile=1024:1024", "--ulimit=nproc=1024:1024"]
        folder = f"--volume={self.folder}:/data"
        return [*self.podman, "run", "--rm", "--network=host", *limits, *names, folder, "poegp-trial"]

    def leave(self):
        if hasattr(self, "podman"):
            run([*self.podman, "system", "reset", "--force"], check=False)
            shutil.rmtree(self.storage, ignore_errors=True)
        super().leave()


class Wine(System):
    """Wine, with a prefix of its own."""

    title = "Wine"
    by_terminal = True

    def set_up(self):
        self.wine = need("wine", "wine64 wine")
        self.prefix = Path(f"{self.work}-prefix")
        shutil.rmtree(self.prefix, ignore_errors=True)
        shutil.copy2(self.files[0], self.work / "trainer.exe")
        self.lend_random_numbers()
        # Wine's own setting up is not the program's.
        run([self.wine, "wineboot", "--init"], env=self.environment(), timeout=600)
        self.started = time.monotonic()

    def lend_random_numbers(self):
        """Rust's library takes random numbers from a library that Windows has, and Wine from version 9 on."""
        if any(Path("/usr").glob("lib/**/wine/x86_64-windows/bcryptprimitives.dll")):
            return
        source = self.work / "bcryptprimitives.c"
        source.write_text(
            "#include <windows.h>\n"
            "BOOLEAN NTAPI SystemFunction036(PVOID, ULONG);\n"
            "__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE data, SIZE_T size) "
            "{ return SystemFunction036(data, (ULONG)size); }\n"
        )
        compiler = need("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64")
        run([compiler, "-shared", "-O1", source, "-o", source.with_suffix(".dll"), "-ladvapi32"])
        source.unlink()
        self.title = "Wine before 9, bcryptprimitives.dll lent"

    def environment(self):
        return super().environment() | {"WINEPREFIX": str(self.prefix), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}

    def command(self):
        return [self.wine, self.work / "trainer.exe"]

    def leave(self):
        if hasattr(self, "prefix"):
            run(["wineserver", "-k"], env=self.environment(), check=False) if shutil.which("wineserver") else None
            run([self.wine, "wineboot", "--kill"], env=self.environment(), check=False)
            shutil.rmtree(self.prefix, ignore_errors=True)
        super().leave()


SYSTEMS = {
    "linux-amd64": EmptyRoot,
    "linux-arm64": EmulatedRoot,
    "package": Debian,
    "container": Container,
    "windows": Wine,
}
