"""A gateway process, and a PLC in the interpreter that exchanges registers with the gateway."""

import json
import socket
import struct
import subprocess
import time
import urllib.request

from st import StError

CYCLE = 0.01  # s
CYCLES_PER_EXCHANGE = 2


def expect(got, wanted, what):
    if got != wanted:
        raise StError(f"{what}: {got}, not {wanted}")


class Gateway:
    """The program under test, with its two simulated grippers: unit 1 has a part of 20 mm, unit 2 has none."""

    def __init__(self, program):
        self.program, self.modbus = program, "127.0.0.1:0"
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [self.program, "--listen", "127.0.0.1:0", "--zenoh-listen", "tcp/127.0.0.1:0", "--journal", ":memory:",
             "--modbus", self.modbus], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            self.wait_until_it_serves()
        except Exception:
            self.stop()
            raise

    def wait_until_it_serves(self):
        for line in self.process.stdout:
            if " at http://" in line:
                self.host = line.split("http://")[1].strip().rstrip("/")
            elif line.startswith("Modbus: "):
                # A restarted gateway has the same port.
                self.modbus = line.split()[1]
            elif line.startswith("try: "):
                break
        for _ in range(100):
            if all(gripper["link"] == "connected" for gripper in self.http("GET", "grippers")["grippers"]):
                return
            time.sleep(0.05)
        raise StError("the gateway does not connect to its grippers")

    def stop(self):
        self.process.kill()
        self.process.communicate()

    def restart(self):
        self.stop()
        self.start()

    def http(self, method, path, body=None, lease=""):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://{self.host}/api/v1/{path}", data, {"Wsg-Lease": lease}, method=method)
        with urllib.request.urlopen(request, timeout=10) as response:
            return json.load(response)

    def recipe(self, number, **values):
        self.http("PUT", f"recipes/part-{number}", {"number": number, **values})


class Plc:
    """A PLC with its Modbus master. It runs one program, or FB_WsgClient and the blocks that a test names."""

    def __init__(self, project, gateway, unit=1, program=None):
        self.project, self.gateway, self.unit = project, gateway, unit
        self.socket, self.cycles, self.sent, self.exceptions = None, 0, [], []
        self.is_connected = self.writes = True
        self.frames, self.inputs = {}, {}
        if program is None:
            self.link = project.new(("struct", "st_wsglink"))
            self.client = self.registers = self.block("FB_WsgClient")
        else:
            self.program = self.add(program)
            self.registers = project.globals["db_wsg"][1] if "db_wsg" in project.globals else self.program

    def add(self, name):
        self.frames[name], self.inputs[name] = self.project.new(("fb", name.lower())), {}
        return self.frames[name]

    def block(self, name):
        if name not in self.frames:
            self.add(name)["stlink"] = self.link
        return self.frames[name]

    def set(self, name, **inputs):
        self.block(name)
        self.inputs[name].update(inputs)

    def disconnect(self):
        if self.socket:
            self.socket.close()
        self.socket = None

    def exchange(self):
        """Exchanges the registers once. Without an answer, the values that were read last stay."""
        out = self.registers["aout"]
        command = [out[0], *out[1:8], out[9]]
        if out[1] and self.writes and self.sent[-1:] != [command]:
            self.sent.append(command)
        request = struct.pack(">BHHHHB11H", 23, 1100, 16, 100, 11, 22, *out)
        if not self.writes:
            request = struct.pack(">BHH", 3, 1100, 16)
        try:
            if self.socket is None:
                host, port = self.gateway.modbus.split(":")
                self.socket = socket.create_connection((host, int(port)), 1)
            self.socket.sendall(struct.pack(">HHHB", 1, 0, len(request) + 1, self.unit) + request)
            header = self.socket.recv(7, socket.MSG_WAITALL)
            answer = self.socket.recv(int.from_bytes(header[4:6], "big") - 1, socket.MSG_WAITALL) if header else b""
        except OSError:
            answer = b""
        if not answer:
            self.disconnect()
        elif answer[0] & 0x80:
            self.exceptions.append(answer[1])
        else:
            self.registers["ain"] = list(struct.unpack(">16H", answer[2:]))

    def cycle(self):
        if self.is_connected and self.cycles % CYCLES_PER_EXCHANGE == 0:
            self.exchange()
        self.project.now = int(time.monotonic() * 1000)
        for name, frame in self.frames.items():
            self.project.run(frame, **self.inputs[name])
        self.cycles += 1
        time.sleep(CYCLE)

    def wait(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.cycle()

    def until(self, test, what, seconds=10):
        end = time.monotonic() + seconds
        while not test():
            if time.monotonic() > end:
                raise StError(f"not within {seconds} s: {what}")
            self.cycle()

    def prepare(self):
        self.until(lambda: self.client["bprepared"], "prepared")

    def start(self, name, **inputs):
        """Starts a motion, and waits until the fingers move."""
        self.set(name, Execute=True, **inputs)
        self.until(lambda: self.link["stin"]["wstatus"] & 0x42 == 0x42, f"{name} moves the fingers")

    def result(self, name, error=0):
        """Waits for the end of a command block, and checks its result."""
        frame = self.block(name)
        self.until(lambda: frame["done"] or frame["error"], f"{name} ends")
        got = frame["errorid"], frame["done"], frame["error"], frame["busy"]
        expect(got, (error, error == 0, error != 0, False), f"ErrorID, Done, Error and Busy of {name}")
        self.cycle()
        expect(frame["errorid"], error, "a result stays until Execute falls")
        self.set(name, Execute=False)
        self.cycle()
        expect((frame["done"], frame["error"], frame["errorid"]), (False, False, 0), "a result goes with Execute")

    def execute(self, name, error=0, **inputs):
        self.set(name, Execute=True, **inputs)
        self.cycle()
        self.result(name, error)

    def command(self, number, error=0, **registers):
        request = self.project.new(("struct", "st_wsgout"))
        self.execute("FB_WsgCommand", error, stRequest={**request, "ncommand": number, **registers})
