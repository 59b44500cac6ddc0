#!/usr/bin/python3
"""The operator of the cell, which LinuxCNC starts as its display: switches on, homes, runs [POEGP]PROGRAM, waits.

Near a singularity it turns the joint away and goes on. Writes outcome.json: whether the program ended, every message of LinuxCNC.
"""

import json
import sys
import time

import linuxcnc

PATIENCE_S = 180


class Operator:
    def __init__(self, ini):
        self.program = ini.find("POEGP", "PROGRAM")
        self.command, self.status, self.errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
        self.messages = []

    def look(self):
        self.status.poll()
        while (message := self.errors.poll()) is not None:
            self.messages.append(message[1].strip())
        return self.status

    def wait(self, what, is_there, seconds=30):
        end = time.monotonic() + seconds
        while not is_there(self.look()):
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: not within {seconds} s")
            time.sleep(0.02)

    def work(self):
        command = self.command
        command.state(linuxcnc.STATE_ESTOP_RESET)
        self.wait("emergency stop released", lambda s: s.task_state != linuxcnc.STATE_ESTOP)
        command.state(linuxcnc.STATE_ON)
        self.wait("machine on", lambda s: s.task_state == linuxcnc.STATE_ON)
        command.mode(linuxcnc.MODE_MANUAL)
        command.wait_complete()
        command.teleop_enable(0)
        command.wait_complete()
        command.home(-1)
        self.wait("homed", lambda s: all(s.homed[:6]))
        command.mode(linuxcnc.MODE_AUTO)
        self.wait("automatic mode", lambda s: s.task_mode == linuxcnc.MODE_AUTO)
        command.program_open(self.program)
        command.wait_complete()
        command.auto(linuxcnc.AUTO_RUN, 0)
        self.wait("program started", lambda s: s.interp_state != linuxcnc.INTERP_IDLE)
        self.wait("program ended", lambda s: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos, PATIENCE_S)
        return self.status.task_state == linuxcnc.STATE_ON and not self.messages

    def turn_away(self):
        """Switches on again, turns joint 5 by ten degrees in joint mode, then moves up by 5 mm; whether the arm did."""
        command = self.command
        self.wait("machine off", lambda s: s.task_state != linuxcnc.STATE_ON)
        command.state(linuxcnc.STATE_ON)
        self.wait("machine on again", lambda s: s.task_state == linuxcnc.STATE_ON)
        command.mode(linuxcnc.MODE_MANUAL)
        command.wait_complete()
        command.teleop_enable(0)
        self.wait("joint mode", lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_FREE)
        at = self.look().joint_actual_position[4]
        command.jog(linuxcnc.JOG_INCREMENT, True, 4, 20, 10)
        self.wait("joint turned away", lambda s: abs(s.joint_actual_position[4] - at - 10) < 0.01 and s.joint[4]["inpos"])
        # LinuxCNC ignores a change of mode for some cycles after a joint was turned.
        time.sleep(0.5)
        command.mode(linuxcnc.MODE_MDI)
        self.wait("mode of single commands", lambda s: s.task_mode == linuxcnc.MODE_MDI)
        height = self.look().actual_position[2]
        command.mdi("G91 G1 Z5 F600")
        self.wait("tool moved up", lambda s: abs(s.actual_position[2] - height - 5) < 0.01)
        return True


def main():
    operator = Operator(linuxcnc.ini(sys.argv[sys.argv.index("-ini") + 1]))
    outcome = {"ended": False}
    try:
        time.sleep(0.5)
        outcome["ended"] = operator.work()
        if any("singularity" in message for message in operator.messages):
            outcome["turned_away"] = operator.turn_away()
    except (TimeoutError, linuxcnc.error) as error:
        operator.messages.append(str(error))
    time.sleep(0.3)
    operator.look()
    outcome["messages"] = operator.messages
    with open("outcome.json", "w", encoding="utf-8") as file:
        json.dump(outcome, file, indent=2)


if __name__ == "__main__":
    main()
