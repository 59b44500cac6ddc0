"""The trainer beside its peers: which tables, and the programs and data they are made with. Started by `run`."""

import pathlib
import sys

import accuracy
import bending
import growth
import speed
import touches
from programs import Programs


def main():
    what, binaries, folder = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
    programs = Programs(binaries, folder)
    if what in ("speed", "all"):
        speed.table(programs)
    if what in ("growth", "all"):
        growth.table(programs)
    if what in ("touches", "all"):
        touches.check(programs)
    if what in ("accuracy", "all"):
        accuracy.tables(programs)
    if what in ("bending", "all"):
        bending.table(programs)


main()
