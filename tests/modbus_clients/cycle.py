"""A PLC's cycle over Modbus, with pymodbus: a task that runs every 10 ms, and handles faults by the status word alone.

usage: cycle.py URL-OF-THE-GATEWAY HOST PORT NUMBER-OF-GRIPS
       cycle.py --move-only HOST PORT
"""

import json
import subprocess
import sys
import time
import urllib.request

from pymodbus.client import ModbusTcpClient

CYCLE_S = 0.01
DEADLINE_S = 20

# Holding registers of the gateway map, and where its input registers begin among the holding registers.
OUTPUTS, INPUTS = 100, 1100
COUNTER, COMMAND, RECIPE, WIDTH, SPEED, HEARTBEAT, FAST_STOP_NUMBER, FAST_STOP = 0, 1, 2, 3, 4, 8, 9, 10
HOME, MOVE, GRIP, RELEASE, ACKNOWLEDGE = 1, 2, 3, 4, 6
READY, DONE, OK, NOK, HOLDING, MOVING, REFERENCED, FAULT, LATCHED, PREPARED = (
    1 << bit for bit in (0, 2, 3, 4, 5, 6, 7, 8, 9, 13)
)
UNKNOWN = 0x8000


class Plc:
    """The registers of one gripper, exchanged by function code 23 in each cycle."""

    def __init__(self, host, port, unit=1):
        self.client = ModbusTcpClient(host, port=port, timeout=DEADLINE_S)
        assert self.client.connect(), f"no connection to {host}:{port}"
        self.unit = unit
        self.outputs = [0] * 11
        self.cycles = 0
        self.exchange()
        self.until("prepared", lambda: self.status & PREPARED)

    def exchange(self):
        """One cycle."""
        started = time.monotonic()
        self.outputs[HEARTBEAT] = self.cycles % 65535 + 1
        self.cycles += 1
        answer = self.client.readwrite_registers(
            read_address=INPUTS,
            read_count=16,
            write_address=OUTPUTS,
            values=self.outputs,
            device_id=self.unit,
        )
        assert not answer.isError(), answer
        self.inputs = answer.registers
        self.status = self.inputs[1]
        time.sleep(max(0, CYCLE_S - (time.monotonic() - started)))

    def until(self, what, wanted):
        ends = time.monotonic() + DEADLINE_S
        while not wanted():
            assert time.monotonic() < ends, f"not {what}: {self.inputs}"
            self.exchange()

    def run(self, command, **values):
        """Executes a command, and returns its status word."""
        self.outputs[COUNTER] = self.outputs[COUNTER] % 65535 + 1
        self.outputs[COMMAND] = command
        self.outputs[RECIPE] = values.get("recipe", 0)
        self.outputs[FAST_STOP_NUMBER] = values.get("number", 0)
        self.exchange()
        self.until(f"done with command {command}", lambda: self.inputs[0] == self.outputs[COUNTER] and self.status & DONE)
        return self.status


def post(url, path, body, method="POST"):
    data = json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(url + path, data, method=method), timeout=DEADLINE_S) as answer:
        return json.load(answer)


def state(url):
    with urllib.request.urlopen(f"{url}/api/v1/grippers/left/state", timeout=DEADLINE_S) as answer:
        return json.load(answer)


def acknowledge(plc):
    """Clears a fault, as the status word asks for it."""
    while plc.status & (FAULT | LATCHED):
        assert plc.run(ACKNOWLEDGE, number=plc.inputs[11]) & DONE
        plc.exchange()


def cycle(url, host, port, grips):
    recipe = {
        "number": 12, "width_mm": 20, "speed_mm_s": 400, "force_n": 30,
        "accept_min_mm": 19, "accept_max_mm": 21, "release_width_mm": 25,
    }
    post(url, "/api/v1/recipes/A-1047", recipe, "PUT")
    plc = Plc(host, port)
    acknowledge(plc)
    if not plc.status & REFERENCED:
        assert plc.run(HOME) & OK, plc.inputs
    held = faults = 0
    while held < grips:
        if held % 10 == 9 and faults <= held // 10:
            # Somebody else stops the gripper, in the middle of a motion or before it.
            faults += 1
            post(url, "/api/v1/grippers/left/fast-stop", {"reason": "light curtain"})
        status = plc.run(GRIP, recipe=12)
        if status & OK:
            assert status & HOLDING and abs(plc.inputs[9] - 2000) < 100, plc.inputs
            held += 1
            plc.run(RELEASE, recipe=12)
        # The outcome does not matter: the status word says what to do next.
        acknowledge(plc)
    print(f"pymodbus: {held} grips by recipe, {faults} faults, {plc.cycles} cycles")
    plc.client.close()


def fast_stop(url, host, port):
    """FAST STOP by the register, and its acknowledgement by its number."""
    plc = Plc(host, port)
    plc.outputs[FAST_STOP] = 1
    plc.until("latched", lambda: plc.status & LATCHED)
    plc.outputs[FAST_STOP] = 0
    acknowledge(plc)
    assert state(url)["fast_stop"] is False
    plc.client.close()


def kill(url, host, port):
    """A killed client in the middle of a move: the gripper goes into FAST STOP within the heartbeat's time."""
    child = subprocess.Popen([sys.executable, __file__, "--move-only", host, str(port)])
    ends = time.monotonic() + DEADLINE_S
    while not state(url)["moving"]:
        assert time.monotonic() < ends, "the fingers do not move"
    child.kill()
    killed = time.monotonic()
    while not (stopped := state(url)).get("fast_stop_confirmed"):
        assert time.monotonic() < ends, stopped
    took = time.monotonic() - killed
    assert stopped["fast_stop_cause"] == "client_lost", stopped
    print(f"pymodbus: FAST STOP confirmed {took * 1000:.0f} ms after the kill")
    assert took < 1, took
    child.wait()


def move_only(host, port):
    plc = Plc(host, port)
    plc.outputs[WIDTH], plc.outputs[SPEED] = 10000, 50
    plc.run(MOVE)


if sys.argv[1] == "--move-only":
    move_only(sys.argv[2], int(sys.argv[3]))
else:
    url, host, port = sys.argv[1], sys.argv[2], int(sys.argv[3])
    cycle(url, host, port, int(sys.argv[4]))
    fast_stop(url, host, port)
    kill(url, host, port)
    plc = Plc(host, port)
    acknowledge(plc)
    plc.client.close()
