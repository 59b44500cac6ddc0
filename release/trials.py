"""What is tried with each artefact, and what must come out."""

import fcntl
import json
import os
import pty
import re
import resource
import select
import shutil
import signal
import subprocess
import termios
import time
import venv

from common import ROOT, Absent, Failed, headline, need, run, sha256
from parts import BOARDS
from systems import ENVIRONMENT

ROBOT = "abb-irb4400-serial"
DATA = ROOT / "tests/data/simulated"
# Emulated arithmetic takes a hundred times as long: few poses, and each method that has arithmetic of its own.
SMALL = {"elastic": 12, "poe-gp-load": 16}
# Boards whose flash controller QEMU does not have.
NO_FLASH = ("stm32f405",)
CAPI = ROOT / "runtime/capi"
CORTEX_M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]


class Row:
    """What is known about one artefact: a row of the table."""

    def __init__(self, name, files):
        self.name, self.files, self.system = name, files, ""
        # Seconds of the clock; of processors, where they can be counted.
        self.set_up = self.first_result = self.processor = None
        self.passed, self.not_run, self.blobs = [], [], {}

    def ok(self, text):
        self.passed.append(text)
        print(f"ok  {self.name}: {text}", flush=True)

    def skip(self, why):
        self.not_run.append(why)
        print(f"NOT RUN: {self.name}: {why}", flush=True)

    def blob(self, name, path):
        self.blobs[name] = hash_of(path)


def hash_of(path):
    if not path.is_file():
        raise Failed(f"{path.name} was not written")
    return sha256(path)


class Inputs:
    """Files for every system, the models of the ordinary release build, and a device."""

    def __init__(self, work, artefacts):
        self.work, self.artefacts = work, artefacts
        self.emulator = self.port = None
        folder = work / "work" / "inputs"
        folder.mkdir(parents=True)
        run(["cargo", "build", "--quiet", "--locked", "--release", "--package", "poegp-trainer"])
        target = os.environ.get("CARGO_TARGET_DIR", "target")
        self.trainer = ROOT / target / "release/trainer"
        self.folder = folder
        shutil.copy2(DATA / "irb4400_paper_s0_train.csv", folder / "train.csv")
        lines = (folder / "train.csv").read_text().splitlines()
        head = [line for line in lines if line.startswith("#")]
        rows = [line for line in lines if not line.startswith("#")]
        for method, poses in SMALL.items():
            (folder / f"{method}.csv").write_text("\n".join([*head, *rows[: poses + 1], ""]))
        self.row = Row("ordinary release build", [])
        environment = os.environ | ENVIRONMENT
        for arguments, name, csv in calibrations():
            run([self.trainer, *arguments, csv, "--out", name], cwd=folder, env=environment)
            self.row.blob(name, folder / name)
            print(f"{self.row.blobs[name]}  {name}")

    def copy_to(self, folder):
        for path in self.folder.glob("*.csv"):
            shutil.copy2(path, folder / path.name)

    def start_device(self, row):
        """Tries the image of each board under QEMU. That of the first one stays, for the programs to talk to."""
        row.system = "qemu-system-arm"
        need("qemu-system-arm", "qemu-system-arm")
        for board in reversed(BOARDS):
            self.stop_device()
            started = time.monotonic()
            self.emulate(board)
            device, port = [self.trainer, "device"], ["--port", self.port]
            run([*device, "info", *port])
            row.first_result = time.monotonic() - started
            if board in NO_FLASH:
                row.ok(f"{board} answers at a TCP port")
                row.skip(f"a model on {board}: QEMU has no flash controller of it")
                continue
            model, rows = (self.folder / f"elastic.{kind}" for kind in ("blob", "csv"))
            run([*device, "flash", model, *port])
            run([*device, "evaluate", rows, "--blob", model, *port])
            row.ok(f"{board} answers at a TCP port, takes a model and gives its bits")
        row.skip("hardware")

    def emulate(self, board):
        """Starts the firmware of a board, with its link at a TCP port of this machine."""
        elf = next(path for path in self.artefacts["firmware"] if board in path.name)
        said = self.work / "work/device.json"
        said.unlink(missing_ok=True)
        arguments = [self.trainer, "device", "emulate", "--elf", elf, "--board", board, "--json", said]
        arguments += ["--listen", "tcp:127.0.0.1:0", "--log", "tcp:127.0.0.1:0"]
        self.emulator = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
        started = time.monotonic()
        while not said.exists():
            if self.emulator.poll() is not None or time.monotonic() - started > 30:
                raise Failed(f"the emulated {board} does not start")
            time.sleep(0.05)
        self.port = json.loads(said.read_text())["port"]

    def stop_device(self):
        if self.emulator:
            self.emulator.kill()
            self.emulator.wait()
            self.emulator = self.port = None


def calibrations():
    """Words, name of the model, and measurements: a whole calibration, and small ones."""
    yield ["calibrate", "--robot", ROBOT], "whole.blob", "train.csv"
    for method in SMALL:
        yield ["calibrate", "--robot", ROBOT, "--method", method], f"{method}.blob", f"{method}.csv"


def try_system(row, kind, inputs):
    """Everything that the program is tried with."""
    headline(f"{row.name}: {kind.title}")
    row.system = kind.title
    work = inputs.work / "work" / row.name
    system = kind(work, row.files)
    try:
        started = time.monotonic()
        system.set_up()
        # What belongs to the machine and not to the artefact is not counted.
        row.system = system.title
        row.set_up = time.monotonic() - getattr(system, "started", started)
        inputs.copy_to(system.folder)
        first_result(row, system)
        same_blobs(row, system)
        names(row, system)
        line_ends(row, system)
        refuses(row, system)
        interrupted(row, system)
        device(row, system, inputs)
        demo(row, system)
        if hasattr(system, "check_itself"):
            row.ok(system.check_itself())
    finally:
        system.leave()


def processor_seconds():
    """What all processes took that this one has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def first_result(row, system):
    """A model and its report from the measurements of one robot."""
    arguments, name, csv = next(calibrations())
    if system.slowness > 10:
        row.skip("a calibration of 300 poses, which takes more than half an hour under this emulator; the first result is of 12")
        arguments, name, csv = [*arguments, "--method", "elastic"], "elastic.blob", "elastic.csv"
    started, before = time.monotonic(), processor_seconds()
    system.run(*arguments, csv, "--out", name, "--report", "report.html")
    row.first_result = time.monotonic() - started
    if system.own_process:
        row.processor = processor_seconds() - before
    if "</html>" not in (system.folder / "report.html").read_text():
        raise Failed("the report is not complete")
    row.blob(name, system.folder / name)
    row.ok("`calibrate --report`")


def same_blobs(row, system):
    """Small calibrations; the files are compared at the end."""
    for arguments, name, csv in calibrations():
        if csv != "train.csv":
            system.run(*arguments, csv, "--out", name)
            row.blob(name, system.folder / name)
    row.ok("small models")


def names(row, system):
    """Spaces and letters beyond ASCII in every path."""
    folder = system.folder / "Prüfstand Süd 1"
    folder.mkdir()
    shutil.copy2(system.folder / "elastic.csv", folder / "Messung ä 1.csv")
    system.run("calibrate", "--robot", ROBOT, "--method", "poe", "Prüfstand Süd 1/Messung ä 1.csv",
              "--out", "Prüfstand Süd 1/Modell ü.blob", "--report", "Prüfstand Süd 1/Bericht ß.html")  # fmt: skip
    said = system.run("evaluate", "Prüfstand Süd 1/Modell ü.blob", "elastic.csv", "--json", "-").stdout
    json.loads(said)
    if {path.name for path in folder.iterdir()} != {"Messung ä 1.csv", "Modell ü.blob", "Bericht ß.html"}:
        raise Failed(f"found {sorted(path.name for path in folder.iterdir())} in {folder.name}")
    row.ok("spaces and umlauts")


def line_ends(row, system):
    """Windows' ends of lines give the same model: nothing but the file's hash and, hence, the checksum differ."""
    (system.folder / "crlf").mkdir()
    text = (system.folder / "elastic.csv").read_bytes()
    (system.folder / "crlf/elastic.csv").write_bytes(text.replace(b"\n", b"\r\n"))
    system.run("calibrate", "--robot", ROBOT, "--method", "elastic", "crlf/elastic.csv", "--out", "crlf/elastic.blob")
    found = []
    for blob in ("elastic.blob", "crlf/elastic.blob"):
        content = json.loads(system.run("inspect", blob, "--json", "-").stdout)
        digest, checksum = bytes.fromhex(content["data_sha256"]), bytes.fromhex(content["crc"])
        model = (system.folder / blob).read_bytes()
        found.append(model.replace(digest, b"").replace(checksum[::-1], b"").replace(checksum, b""))
    if found[0] != found[1] or hash_of(system.folder / "crlf/elastic.blob") == row.blobs["elastic.blob"]:
        raise Failed("measurements with CRLF give another model")
    row.ok("CRLF")


def refuses(row, system):
    """A wrong file is exit code 2 with its line, and nothing is written."""
    (system.folder / "wrong.csv").write_text((system.folder / "elastic.csv").read_text() + "1,2,three\n")
    done = system.run("calibrate", "--robot", ROBOT, "wrong.csv", "--out", "wrong.blob", check=False)
    if done.returncode != 2 or "wrong.csv:" not in done.stderr or (system.folder / "wrong.blob").exists():
        raise Failed(f"a wrong file: exit code {done.returncode}, {done.stderr[-300:]}")
    row.ok("refuses a wrong file")


def interrupted(row, system):
    """Ctrl-C in the middle of a calibration: exit code 130, and no file."""
    arguments = ["calibrate", "--robot", ROBOT, "train.csv", "--out", "stopped.blob", "--report", "stopped.html"]
    arguments = [str(word) for word in [*system.command(), *arguments]]
    before = {path.name for path in system.folder.iterdir()}
    main, other = pty.openpty()
    process = subprocess.Popen(
        arguments, cwd=system.folder, env=system.environment(), stdin=other, stdout=other, stderr=other,
        start_new_session=True, preexec_fn=lambda: take_terminal(other),
    )  # fmt: skip
    os.close(other)
    time.sleep(4)
    if process.poll() is not None:
        raise Failed("the calibration ended before Ctrl-C")
    if system.by_terminal:
        os.write(main, b"\x03")
    else:
        os.killpg(process.pid, signal.SIGINT)
    started = time.monotonic()
    said = drain(main, process, 60)
    os.close(main)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise Failed(f"Ctrl-C does not end it; it said {said[-300:]!r}")
    left = {path.name for path in system.folder.iterdir()} - before
    if process.returncode != 130 or left:
        raise Failed(f"Ctrl-C: exit code {process.returncode}, left {sorted(left)}, said {said[-300:]!r}")
    row.ok(f"Ctrl-C ({time.monotonic() - started:.1f} s)")


def take_terminal(terminal):
    fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)


def drain(main, process, limit):
    """Reads what a process says until it ends."""
    said, end = b"", time.monotonic() + limit
    while time.monotonic() < end:
        ready, _, _ = select.select([main], [], [], 0.2)
        if ready:
            try:
                said += os.read(main, 65536)
                continue
            except OSError:
                process.wait(max(0.1, end - time.monotonic()))
                break
        if process.poll() is not None:
            break
    return re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", said).decode(errors="replace")


def device(row, system, inputs):
    """A model onto the device and its answers to the bit, over TCP."""
    if not inputs.port:
        row.skip("a device over TCP: release/try firmware starts it")
        return
    port = ["--port", inputs.port]
    system.run("device", "flash", "elastic.blob", "--force", *port)
    system.run("device", "evaluate", "elastic.csv", "--blob", "elastic.blob", *port)
    system.run("device", "info", *port)
    row.ok("a device over TCP")


def demo(row, system):
    if system.slowness > 10:
        row.skip("demo: half a minute natively, an hour or more under this emulator")
        return
    started = time.monotonic()
    system.run("demo", timeout=3600)
    if not list((system.folder / "demo").glob("*.blob")):
        raise Failed("demo wrote no model")
    row.ok(f"`demo` ({time.monotonic() - started:.0f} s)")


def try_wheel(row, inputs):
    """Installs the wheel where nothing else is, and calibrates."""
    row.system = "fresh virtual environment"
    work = inputs.work / "work/wheel"
    work.mkdir()
    inputs.copy_to(work)
    started = time.monotonic()
    venv.create(work / "venv", with_pip=True)
    python = work / "venv/bin/python"
    run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", row.files[0]])
    row.set_up = time.monotonic() - started
    environment = os.environ | ENVIRONMENT
    for arguments, name, csv in calibrations():
        method = f", method={arguments[-1]!r}" if "--method" in arguments else ""
        started, before = time.monotonic(), processor_seconds()
        run([python, "-c", f"import poegp; poegp.calibrate({ROBOT!r}, {csv!r}{method}).save({name!r})"], cwd=work, env=environment)
        row.first_result = row.first_result or time.monotonic() - started
        row.processor = row.processor or processor_seconds() - before
        row.blob(name, work / name)
    row.ok("`calibrate`")
    run([python, "-m", "pip", "uninstall", "--quiet", "-y", "poegp"])
    if run([python, "-c", "import poegp"], check=False, cwd=work).returncode == 0:
        raise Failed("the package is still there after pip uninstall")
    row.ok("removed")
    row.skip("other interpreters than " + run([python, "--version"]).stdout.strip())
    shutil.rmtree(work)


def try_library(row, inputs):
    """Compiles the examples of the archive as pkg-config says, and compares what host and device say."""
    row.system = "gcc; arm-none-eabi-gcc and qemu-system-arm"
    need("pkg-config", "pkg-config")
    need("cc", "gcc")
    said = {}
    for archive in row.files:
        work = inputs.work / "work" / archive.name.removesuffix(".tar.gz")
        run(["tar", "-C", work.parent, "-xzf", archive])
        environment = os.environ | {"PKG_CONFIG_PATH": str(work / "lib/pkgconfig")}
        flags = {
            asked: run(["pkg-config", asked, "poegp"], env=environment).stdout.split() for asked in ("--cflags", "--libs")
        }
        examples, made = work / "examples", work / "example"
        if "thumb" in archive.name:
            compiler = need("arm-none-eabi-gcc", "gcc-arm-none-eabi libnewlib-arm-none-eabi")
            need("qemu-system-arm", "qemu-system-arm")
            arguments = [compiler, "-std=c11", "-O2", *CORTEX_M4F, "-ffunction-sections", "-fdata-sections", *flags["--cflags"]]
            arguments += [f"-Wa,-I,{examples}", "-nostartfiles", "-Wl,--gc-sections,-z,noexecstack", "-T", examples / "device.ld"]
            run([*arguments, examples / "device.c", *flags["--libs"], "-o", made])
            arguments = ["qemu-system-arm", "-M", "mps2-an386", "-cpu", "cortex-m4", "-display", "none", "-monitor", "none", "-serial"]
            arguments += ["none", "-chardev", f"file,id=said,path={work}/said", "-semihosting-config", "enable=on,target=native,chardev=said"]
            run([*arguments, "-kernel", made], timeout=60)
            said["device"] = (work / "said").read_text().splitlines()
        else:
            started = time.monotonic()
            run(["cc", "-std=c11", "-O2", *flags["--cflags"], examples / "host.c", *flags["--libs"], "-o", made])
            said["host"] = run([made, examples / "arm.blob"]).stdout.splitlines()
            row.first_result = time.monotonic() - started
    device_lines = [line for line in said["device"] if not line.startswith("stack")]
    if not said["host"] or said["host"] != device_lines:
        raise Failed("the example gives other bits on the device than on this host")
    row.ok(f"{len(device_lines)} lines of bits, host and Cortex-M4F the same")
