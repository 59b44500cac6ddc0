"""A Slurm cluster of one node in a folder of its own: own key, configuration, sockets, ports of the loopback interface, state.

Nothing outside the folder is written. All processes are descendants of this one, which adopts those whose parent has ended
(Linux only), so that what is left behind can be counted and ended.
"""

import ctypes
import getpass
import os
import pathlib
import re
import shlex
import shutil
import signal
import socket
import subprocess
import time

CONFIGURATION = """
ClusterName=poegp
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
# No cgroups, which a container may lack, and no accounting, which needs a database.
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/filetxt
JobCompLoc={folder}/completed.txt
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
ReturnToService=2
MpiDefault=none
{plugins}
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""

PR_SET_CHILD_SUBREAPER = 36


class NotStarted(Exception):
    """The cluster cannot run here."""


def adopt_orphans() -> None:
    """From now on a descendant whose parent ends becomes a child of this process."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def descendants() -> dict[int, str]:
    """Command lines of all processes that this one has started, directly or not, by number."""
    parents, commands = {}, {}
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            # After the last bracket, because a name may contain anything.
            state, parent = (entry / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[:2]
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except (OSError, ValueError):
            continue
        if state != "Z":
            parents[int(entry.name)], commands[int(entry.name)] = int(parent), command.strip()

    def is_ours(process: int) -> bool:
        while process in parents:
            process = parents[process]
            if process == os.getpid():
                return True
        return False

    return {process: commands[process] for process in parents if is_ours(process)}


def end_all() -> None:
    """Kills every descendant, and what these leave to this process."""
    while left := descendants():
        for process in left:
            try:
                os.kill(process, signal.SIGKILL)
            except ProcessLookupError:
                pass
        time.sleep(0.05)
    reap()


def reap() -> None:
    """Takes note of ended children, so that the system forgets them."""
    try:
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass
    except ChildProcessError:
        pass


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()


class Cluster:
    """Daemons by name; used as a context, which ends them and everything they have started."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self.daemons: dict[str, subprocess.Popen] = {}
        shutil.rmtree(folder, ignore_errors=True)
        for name in ("state", "spool"):
            (folder / name).mkdir(parents=True, mode=0o755)
        key = folder / "munge.key"
        key.touch(mode=0o600)
        key.write_bytes(os.urandom(1024))
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20
        plugins = os.environ.get("SLURM_PLUGINS")
        self.configuration = folder / "slurm.conf"
        self.configuration.write_text(
            CONFIGURATION.format(
                folder=folder,
                host=socket.gethostname().split(".")[0],
                user=getpass.getuser(),
                ports=free_ports(2),
                cpus=os.cpu_count(),
                memory=memory,
                plugins=f"PluginDir={plugins}" if plugins else "",
            ),
            encoding="utf-8",
        )
        os.environ["SLURM_CONF"] = str(self.configuration)
        # In a job, snakemake-executor-plugin-slurm clears this variable before it calls srun, which would then read the
        # file in /etc that a cluster has and this one has not.
        srun = folder / "bin" / "srun"
        srun.parent.mkdir()
        real = shlex.quote(str(shutil.which("srun")))
        srun.write_text(f'#!/bin/sh\nSLURM_CONF={shlex.quote(str(self.configuration))} exec {real} "$@"\n', encoding="utf-8")
        srun.chmod(0o755)
        os.environ["PATH"] = f"{srun.parent}:{os.environ['PATH']}"

    def __enter__(self) -> "Cluster":
        try:
            self.start()
        except BaseException:
            end_all()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        end_all()

    def start_daemon(self, name: str) -> None:
        """In the foreground, so that it stays a child of this process."""
        own = {
            "munged": ["--foreground", "--force", "--num-threads=2"]
            + [f"--{what}={self.folder / file}" for what, file in MUNGE_FILES.items()],
            "slurmctld": ["-D"],
            # Where it looks for this program is compiled in.
            "slurmd": ["-D", "-d", str(shutil.which("slurmstepd"))],
        }
        with (self.folder / f"{name}.out").open("ab") as out:
            # A session of its own: Ctrl-C in the terminal is for this process, which ends them in order.
            self.daemons[name] = subprocess.Popen(
                [name, *own[name]], stdin=subprocess.DEVNULL, stdout=out, stderr=out, cwd=self.folder, start_new_session=True
            )

    def start(self) -> None:
        self.start_daemon("munged")
        self.wait_for(lambda: (self.folder / "munge.socket").exists(), "munged has no socket", 10)
        self.start_slurm()

    def start_slurm(self) -> None:
        for name in ("slurmctld", "slurmd"):
            self.start_daemon(name)
        self.wait_for(lambda: self.ask("sinfo", "-h", "-o", "%t").strip() in ("idle", "mix", "alloc"), "the node is not up", 60)

    def kill_slurm(self) -> None:
        """Both daemons at once, as a power cut would; the jobs' own processes go on."""
        for name in ("slurmctld", "slurmd"):
            self.daemons[name].kill()
        for name in ("slurmctld", "slurmd"):
            self.daemons.pop(name).wait()

    def stop(self) -> dict[int, str]:
        """Ends the daemons as their administrator would; the processes that are left."""
        for name in ("slurmd", "slurmctld", "munged"):
            daemon = self.daemons.pop(name)
            daemon.terminate()
            daemon.wait(60)
        # Snakemake takes seconds to end on a busy machine; what was forgotten stays for good.
        deadline = time.monotonic() + 60
        while (left := descendants()) and time.monotonic() < deadline:
            time.sleep(0.1)
        reap()
        return left

    def ask(self, *command: str) -> str:
        """What one of Slurm's commands prints; nothing when it fails."""
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout

    def jobs(self, state: str) -> list[str]:
        """Numbers of the jobs in a state."""
        return self.ask("squeue", "-h", "-t", state, "-o", "%i").split()

    def states(self) -> dict[str, str]:
        """How each job ended that has ended, by its number."""
        text = (self.folder / "completed.txt").read_text(encoding="utf-8")
        return dict(re.findall(r"^JobId=(\d+) .*?JobState=(\w+)", text, re.MULTILINE))

    def is_idle(self) -> bool:
        """No job waits, runs or ends."""
        done = subprocess.run(["squeue", "-h"], capture_output=True, text=True, check=False)
        return done.returncode == 0 and not done.stdout.strip()

    def wait_for(self, holds, what: str, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not holds():
            ended = [name for name, daemon in self.daemons.items() if daemon.poll() is not None]
            if ended or time.monotonic() > deadline:
                raise NotStarted(f"{what}{''.join(f'; {name} has ended: {self.last_lines(name)}' for name in ended)}")
            time.sleep(0.1)

    def last_lines(self, name: str) -> str:
        text = "".join(
            file.read_text(encoding="utf-8", errors="replace")
            for file in (self.folder / f"{name}.log", self.folder / f"{name}.out")
            if file.exists()
        )
        return " / ".join(text.strip().splitlines()[-3:])


MUNGE_FILES = {
    "key-file": "munge.key",
    "socket": "munge.socket",
    "pid-file": "munged.pid",
    "log-file": "munged.log",
    "seed-file": "munged.seed",
}
