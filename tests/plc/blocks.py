"""Checks the PLC sources, and runs their blocks against a gateway: blocks.py PROGRAM-OF-THE-GATEWAY"""

import random
import re
import socket
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import st
from rig import Gateway, Plc, expect

SOURCES = Path(__file__).resolve().parent.parent.parent / "deploy" / "plc"
PART = {"width_mm": 20, "speed_mm_s": 200, "force_n": 30, "accept_min_mm": 19, "accept_max_mm": 21,
        "release_width_mm": 35}
STUBS = Path(__file__).with_name("tia_stubs.st")
FOLDERS = ("codesys", "tia", "http")
STATUS_BITS = ("bready", "bcmdbusy", "bcmddone", "bcmdok", "bcmdnok", "bholding", "bmoving", "breferenced", "bfault",
               "bfaststop", "bleasemine", "bleaseother", "bconnected", "bprepared")


def near(got, wanted, what):
    expect(abs(got - wanted) < 0.2, True, f"{what}, which is {got}, is {wanted}")


def recipes(plc):
    status = plc.block("FB_WsgStatus")
    plc.gateway.recipe(12, **PART)
    plc.gateway.recipe(13, **{**PART, "accept_min_mm": 21})
    plc.prepare()
    plc.execute("FB_WsgGrip", error=0x0209, nRecipe=12)
    plc.execute("FB_WsgHome")
    expect(plc.client["aout"][1:8], [0] * 7, "registers after a command")
    expect((status["rcontactwidth"], status["bpeakforceknown"]), (0.0, False), "values before the first grip")
    plc.execute("FB_WsgGrip", nRecipe=12)
    expect((status["bholding"], status["noutcome"], status["nstate"], status["nmotionnumber"]), (True, 2, 4, 2), "grip")
    near(status["rcontactwidth"], 20, "contact width")
    near(status["rpeakforce"], 30, "peak force")
    near(status["rforce"], 30, "force")
    near(status["rtemperature"], 25, "temperature")
    plc.execute("FB_WsgRelease", nRecipe=12)
    near(status["rwidth"], 35, "width of the recipe's release")
    plc.execute("FB_WsgGrip", error=0x010B, nRecipe=13)
    expect(status["bholding"], True, "the wrong part is held")
    plc.execute("FB_WsgRelease", nRecipe=13, bOverride=True, rWidth=50.0, rSpeed=400.0)
    near(status["rwidth"], 50, "width of the overridden release")
    plc.execute("FB_WsgGrip", nRecipe=12, bOverride=True, rForce=40.0)
    near(status["rpeakforce"], 40, "peak force of the overridden grip")
    plc.execute("FB_WsgRelease", error=0x0204, nRecipe=99)


def values(plc):
    status = plc.block("FB_WsgStatus")
    plc.prepare()
    expect((status["bwidthknown"], status["breferenced"]), (False, False), "values before homing")
    plc.execute("FB_WsgHome", nDirection=2)
    near(status["rwidth"], 1, "width after homing inwards")
    plc.execute("FB_WsgHome", nDirection=1)
    near(status["rwidth"], 109, "width after homing outwards")
    plc.execute("FB_WsgMove", rWidth=60.0, rSpeed=400.0)
    plc.start("FB_WsgMove", rWidth=-10.5, rSpeed=20.0, bRelative=True, bClamp=True)
    plc.until(lambda: abs(status["rspeed"] + 20) < 1, "speed of a closing motion")
    plc.result("FB_WsgMove")
    near(status["rwidth"], 49.5, "width after a relative move")
    plc.execute("FB_WsgGrip", error=0x0103, rWidth=20.0, rSpeed=200.0, rForce=30.5)
    plc.execute("FB_WsgRelease", rWidth=60.0, rSpeed=200.5)
    commands = [[1, 0, 0, 0, 0, 32, 0, 0], [1, 0, 0, 0, 0, 16, 0, 0], [2, 0, 6000, 4000, 0, 0, 0, 0],
                [2, 0, 64486, 200, 0, 3, 0, 0], [3, 0, 2000, 2000, 305, 0, 0, 0], [4, 0, 6000, 2005, 0, 0, 0, 0]]
    expect([registers[1:] for registers in plc.sent], commands, "registers of the commands")
    plc.execute("FB_WsgMove", error=0x0306, rWidth=400.0)
    plc.execute("FB_WsgGrip", error=0x0306, nRecipe=256)
    plc.execute("FB_WsgHome", error=0x0306, nDirection=3)
    expect((len(plc.sent), plc.exceptions), (6, []), "commands with a wrong parameter are not sent")
    plc.execute("FB_WsgMove", error=0x0212, rWidth=300.0, bRelative=False)
    expect(plc.exceptions, [3], "exceptions")
    plc.execute("FB_WsgMove", rWidth=50.0)


def one_command_at_a_time(plc):
    plc.prepare()
    plc.start("FB_WsgHome")
    plc.execute("FB_WsgGrip", error=0x0302, nRecipe=1)
    expect(plc.block("FB_WsgHome")["busy"], True, "the first command goes on")
    plc.execute("FB_WsgStop")
    plc.result("FB_WsgHome", error=0x0304)
    # A Stop in the cycle after the start, before the gateway has seen the motion.
    plc.set("FB_WsgHome", Execute=True)
    plc.cycle()
    plc.execute("FB_WsgStop")
    plc.result("FB_WsgHome", error=0x0304)
    expect(plc.link["stin"]["wstatus"] & 0x40, 0, "the fingers move")
    # Done is shown for one cycle if Execute fell before the end.
    plc.set("FB_WsgHome", Execute=True)
    plc.cycle()
    plc.set("FB_WsgHome", Execute=False)
    home, shown = plc.block("FB_WsgHome"), []

    def has_ended():
        shown.append(home["done"])
        return not home["busy"] and not home["done"]

    plc.until(has_ended, "end of homing")
    expect(shown.count(True), 1, "cycles with Done")


def counters(plc):
    plc.client["ncounter"], plc.client["nheartbeat"] = 65533, 65530
    beats = []
    for _ in range(20):
        plc.cycle()
        beats.append(plc.client["aout"][8])
    expect((len(set(beats)), 0 in beats), (20, False), "the heartbeat changes in each cycle, and is not 0")
    plc.prepare()
    for counter in (65535, 1):
        plc.execute("FB_WsgStop")
        expect((plc.sent[-1][0], plc.link["stin"]["ncounter"]), (counter, counter), "counter")


def lease(plc):
    status, path = plc.block("FB_WsgStatus"), "grippers/left/lease"
    plc.prepare()
    token = plc.gateway.http("POST", path, {"holder": "other", "ttl_ms": 60000})["token"]
    plc.execute("FB_WsgHome", error=0x020C)
    expect((status["bleaseother"], status["bready"]), (True, False), "lease of another client")
    plc.gateway.http("DELETE", path, lease=token)
    # 2: a lost client's motion ends with a Stop.
    plc.command(7, wonloss=2)
    expect((status["bleasemine"], status["bready"]), (True, True), "own lease")
    plc.start("FB_WsgHome")
    plc.disconnect()
    plc.result("FB_WsgHome", error=0x0303)
    expect((status["bfaststop"], status["bleasemine"]), (False, False), "the lease was lost, and its motion stopped")
    plc.execute("FB_WsgHome")
    expect(status["bleasemine"], True, "a motion takes the lease")
    plc.command(8)
    expect(status["bleasemine"], False, "the lease was released")


def not_taken_up(plc):
    plc.prepare()
    plc.writes, start = False, time.monotonic()
    plc.execute("FB_WsgHome", error=0x0301)
    expect(2 <= time.monotonic() - start < 3, True, "tTakeUp")
    plc.writes = True
    plc.prepare()
    plc.wait(0.2)
    expect((plc.sent, plc.link["stin"]["nmotionlow"]), ([], 0), "the command is withdrawn")
    plc.execute("FB_WsgHome")


def lost_connection(plc):
    status = plc.block("FB_WsgStatus")
    plc.execute("FB_WsgHome", error=0x0303)
    plc.prepare()
    plc.start("FB_WsgHome")
    plc.is_connected = False
    plc.disconnect()
    plc.result("FB_WsgHome", error=0x0303)
    expect((plc.client["bonline"], status["bmoving"]), (False, False), "state without a connection")
    plc.is_connected = True
    plc.prepare()
    expect((status["nfault"], status["nmotionnumber"]), (11, 1), "FAST STOP of a lost client, and nothing is repeated")
    plc.execute("FB_WsgAcknowledge")
    plc.execute("FB_WsgHome")


def stopped_program(plc):
    """The master goes on while the program stands."""
    status = plc.block("FB_WsgStatus")
    plc.set("FB_WsgClient", bUseHeartbeat=False)
    plc.prepare()
    plc.execute("FB_WsgHome")
    plc.start("FB_WsgMove", rWidth=50.0, rSpeed=10.0)
    for fault in (0, 11):
        for _ in range(65):
            plc.exchange()
            time.sleep(0.02)
        plc.cycle()
        plc.wait(0.1)
        expect(status["nfault"], fault, "fault code")
        plc.set("FB_WsgClient", bUseHeartbeat=True)
        plc.wait(0.1)
    plc.result("FB_WsgMove", error=0x0105)


def restarted_gateway(plc):
    status = plc.block("FB_WsgStatus")
    plc.prepare()
    plc.start("FB_WsgHome")
    plc.gateway.restart()
    plc.result("FB_WsgHome", error=0x0303)
    plc.prepare()
    plc.wait(0.2)
    expect((len(plc.sent), status["nmotionnumber"]), (1, 0), "nothing is repeated")
    plc.execute("FB_WsgHome")


def restarted_plc(plc):
    plc.prepare()
    plc.start("FB_WsgHome")
    plc.disconnect()
    again = Plc(plc.project, plc.gateway)
    again.registers["ain"] = plc.registers["ain"]
    again.cycle()
    expect(again.client["bonline"], False, "old registers are no sign of life")
    again.prepare()
    again.wait(0.2)
    expect((again.sent, again.link["stin"]["nmotionlow"]), ([], 1), "nothing is repeated")
    again.execute("FB_WsgAcknowledge")
    again.execute("FB_WsgHome")


def fast_stop(plc):
    status = plc.block("FB_WsgStatus")
    plc.is_connected = False
    plc.set("FB_WsgClient", bFastStop=True)
    plc.cycle()
    expect(plc.client["aout"][10], 1, "FAST STOP register without a connection")
    plc.is_connected = True
    plc.until(lambda: status["bfaststop"], "FAST STOP of an unknown client", 3)
    plc.prepare()
    plc.execute("FB_WsgAcknowledge", error=0x0208)
    plc.set("FB_WsgClient", bFastStop=False)
    plc.cycle()
    expect(plc.client["aout"][10], 0, "FAST STOP register")
    plc.execute("FB_WsgHome", error=0x0208)
    plc.command(6, error=0x020E, nfaststopnumber=status["nfaststopnumber"] + 1)
    plc.execute("FB_WsgAcknowledge")
    expect((status["bfaststop"], status["nfaststopnumber"]), (False, 0), "acknowledged")
    for of_another_client in (True, False):
        plc.start("FB_WsgHome")
        if of_another_client:
            plc.gateway.http("POST", "grippers/left/fast-stop", {})
        plc.set("FB_WsgClient", bFastStop=not of_another_client)
        plc.result("FB_WsgHome", error=0x0105)
        plc.set("FB_WsgClient", bFastStop=False)
        plc.until(lambda: status["nfault"] == 10, "fault code")
        plc.execute("FB_WsgAcknowledge")


def status_bits(plc):
    status = plc.block("FB_WsgStatus")
    plc.prepare()
    for bit, name in enumerate(STATUS_BITS):
        plc.link["stin"]["wstatus"] = 1 << bit
        plc.project.run(status)
        expect([n for n in STATUS_BITS if status[n]], [name], f"status bit {bit}")
    plc.link["stin"].update(nmotionhigh=2, nmotionlow=3)
    plc.link["bonline"] = False
    plc.project.run(status)
    expect([n for n in STATUS_BITS if status[n]], [], "status bits without a connection")
    expect(status["nmotionnumber"], 131075, "motion number")


class Example:
    """The example, with its buttons and its step."""

    def __init__(self, plc):
        self.plc, self.program = plc, plc.program
        self.buttons = plc.inputs[self.program[""].name]
        plc.gateway.recipe(1, **PART)
        self.arm()

    def until(self, step, alarm=0, **inputs):
        self.buttons.update(inputs)
        self.plc.until(lambda: self.program["nstep"] == step, f"step {step} after {inputs}")
        expect(self.program["walarmid"], alarm, f"ErrorID of the alarm at step {step}")

    def press(self, button):
        for is_pressed in (True, False):
            self.buttons[button] = is_pressed
            self.plc.cycle()

    def arm(self):
        self.buttons.update(bStart=False, bPlaced=False)
        self.plc.until(lambda: self.program["bstartarmed"] and self.program["bplacedarmed"], "new signals count")

    def stays(self, step, motions, why):
        """Expects that the step stays for a while, and that no motion begins."""
        self.plc.wait(0.3)
        sent = [command[1] for command in self.plc.sent if command[1] < 5]
        expect((self.program["nstep"], sent), (step, motions), why)


def example(plc):
    program, one = plc.program, Example(plc)
    one.until(30, bStart=True)
    one.until(0, bStart=False, bPlaced=True)
    plc.gateway.recipe(1, **{**PART, "width_mm": 30})
    one.buttons.update(bStart=True, bPlaced=False)
    plc.until(lambda: program["bempty"], "the gripper finds no part")
    one.until(0, bStart=False)
    expect([command[1] for command in plc.sent], [1, 3, 4, 3, 4], "commands")
    one.until(20, bStart=True)
    plc.until(lambda: program["fbstatus"]["bmoving"], "motion")
    one.until(90, bFastStopInput=True, alarm=0x0105)
    one.buttons.update(bFastStopInput=False)
    plc.until(lambda: program["fbstatus"]["bfaststop"], "FAST STOP")
    one.press("bAckButton")
    plc.until(lambda: not program["fbstatus"]["bfaststop"], "acknowledged")
    one.until(90)
    one.press("bAckButton")
    one.until(0)
    expect(program["balarm"], False, "alarm")
    one.stays(0, [1, 3, 4, 3, 4, 3], "the acknowledge button moves nothing, although bStart is set")
    one.arm()
    one.until(20, bStart=True)


def example_with_stop(plc):
    """After an alarm or a Stop, and while the Stop button is held, no motion begins, and no part is released."""
    program, one = plc.program, Example(plc)
    one.until(30, bStart=True)
    one.buttons.update(bStart=False, bStopButton=True, bPlaced=True)
    one.stays(30, [1, 3], "no part is released while the Stop button is held")
    one.buttons.update(bStopButton=False)
    one.stays(30, [1, 3], "nor after it")
    one.press("bReleaseButton")
    one.until(0)
    one.arm()
    plc.gateway.recipe(1, **{**PART, "accept_min_mm": 21})
    one.until(90, bStart=True, bPlaced=False, alarm=0x010B)
    one.press("bAckButton")
    one.stays(90, [1, 3, 4, 3], "a wrong part is not placed")
    one.buttons.update(bStopButton=True)
    one.press("bReleaseButton")
    one.stays(90, [1, 3, 4, 3], "the release button waits for the end of the Stop")
    one.buttons.update(bStopButton=False)
    one.press("bReleaseButton")
    one.until(0)
    one.stays(0, [1, 3, 4, 3, 4], "no grip begins after an alarm, although bStart is set")
    plc.gateway.recipe(1, **PART)
    one.arm()
    one.until(20, bStart=True)
    plc.until(lambda: program["fbstatus"]["bmoving"], "motion")
    one.until(90, bStopButton=True, alarm=0x0304)
    plc.until(lambda: not program["fbstatus"]["bmoving"], "end of the motion")
    one.press("bAckButton")
    one.until(0, alarm=0x0304)
    one.stays(0, [1, 3, 4, 3, 4, 3], "no motion begins while the Stop button is held")
    one.buttons.update(bStopButton=False)
    one.stays(0, [1, 3, 4, 3, 4, 3], "nor after it")
    one.arm()
    one.until(30, bStart=True)
    # The next part waits already, so bStart stays set.
    one.buttons.update(bStopButton=True)
    one.stays(30, [1, 3, 4, 3, 4, 3, 3], "the part stays held")
    one.buttons.update(bStopButton=False)
    plc.until(lambda: program["bplacedarmed"], "a new signal counts")
    one.until(0, bPlaced=True)
    one.arm()
    one.until(30, bStart=True)
    # Another client takes the part.
    lease = plc.gateway.http("POST", "grippers/left/lease", {"holder": "other", "force": True})["token"]
    plc.gateway.http("POST", "grippers/left/release", {"width_mm": 60, "speed_mm_s": 200}, lease=lease)
    one.until(90)
    plc.is_connected = False
    plc.disconnect()
    plc.until(lambda: not program["fbclient"]["bonline"], "lost connection")
    one.buttons.update(bStopButton=True)
    plc.until(lambda: program["walarmid"] == 0x0303, "alarm of a failed Stop")


def random_faults(plc):
    """After any sequence of faults and buttons, the example works again, and FAST STOP has followed its input."""
    program, chance = plc.program, random.Random(1)
    plc.gateway.recipe(1, **PART)
    buttons = plc.inputs["PRG_Example"]
    for i in range(400):
        if i % 7 == 0:
            for name, likely in (("bStart", 0.7), ("bPlaced", 0.3), ("bAckButton", 0.4), ("bReleaseButton", 0.1),
                                 ("bStopButton", 0.03), ("bFastStopInput", 0.02)):
                buttons[name] = chance.random() < likely
            plc.is_connected = chance.random() > (0.02 if plc.is_connected else 0.8)
            plc.writes = chance.random() > (0.02 if plc.writes else 0.8)
            if chance.random() < 0.05:
                plc.disconnect()
        plc.cycle()
        expect(plc.registers["aout"][10], int(buttons["bFastStopInput"]), "FAST STOP register")
    plc.is_connected = plc.writes = True
    buttons.update(bPlaced=False, bStopButton=False, bFastStopInput=False)
    for i in range(60):
        buttons.update(bStart=program["bstartarmed"], bAckButton=i % 4 == 0, bReleaseButton=i % 4 == 2)
        plc.wait(0.1)
        if program["nstep"] == 30 and not program["balarm"]:
            return
    raise st.StError(f"the example does not recover: step {program['nstep']}, ErrorID {program['walarmid']:04X}")


def grip_cycle(plc):
    """A grip cycle over HTTP, with the texts that the blocks build."""
    project, gateway, request = plc.project, plc.gateway, plc.program
    status, value = project.new(("fb", "fb_wsghttpstatus")), project.new(("fb", "fb_wsghttpvalue"))
    gateway.recipe(12, **PART)
    host, port = gateway.host.split(":")
    inputs = dict(sHost=gateway.host, sGripper="left", sHolder="plc-1", nTtl=3000, nRecipe=12, nBoot=3, nNumber=0)

    def send(kind):
        project.run(request, nRequest=kind, **inputs)
        with socket.create_connection((host, int(port)), 5) as connection:
            connection.sendall((request["shead"] + request["sbody"]).encode())
            head, body = b"", b""
            stream = connection.makefile("rb")
            while not head.endswith(b"\r\n\r\n"):
                head += stream.readline()
            body = stream.read(int(re.search(rb"content-length: (\d+)", head).group(1)))
        return head.decode(), body.decode()

    def field(body, key):
        project.run(value, sText=body[:255], sKey=key)
        return value["svalue"]

    inputs["sLease"] = field(send(1)[1], "token").strip('"')
    for kind, outcome in ((2, 1), (3, 2), (4, 1)):
        inputs["nNumber"] += 1
        number = field(send(kind)[1], "number")
        end = time.monotonic() + 5
        while (status["bbusy"] or status["slastcommand"] != number) and time.monotonic() < end:
            time.sleep(0.02)
            project.run(status, sResponse="".join(send(5)))
            expect(status["bvalid"], True, "a status response is evaluated")
        flags = [status[n] for n in ("bdone", "bok", "bnok", "bholding", "bfault")]
        expect((status["noutcome"], flags), (outcome, [True, True, False, kind == 3, False]), f"end of request {kind}")
    expect('"code":"request_id_reused"' in send(3)[1], True, "an id that was used is refused")
    gateway.http("POST", "grippers/left/fast-stop", {})
    text = "".join(send(5))
    project.run(status, sResponse=text)
    expect((status["bfault"], status["nfaultcode"]), (True, 10), "FAST STOP")
    cut = text[: text.index("last_outcome") + 20]
    for bad in ("", "HTTP/1.1 503 Service Unavailable\r\n\r\n", cut, "HTTP/1.1 200 OK\r\n\r\n{}"):
        project.run(status, sResponse=bad)
        expect((status["bvalid"], status["bbusy"], status["bfault"]), (False, True, False), "incomplete response")
    project.run(request, nRequest=6)
    expect(request["bvalid"], False, "unknown request")
    project.run(request, nRequest=3, nRecipe=255, nBoot=65535, nNumber=65535, sBearer="x" * 47, sLease="f" * 32,
                sHost="h" * 40, sGripper="g" * 32)
    expect(request["bvalid"], True, "longest request")


def load(projects, processes, folder):
    """Parses, type-checks and compiles the sources of a folder."""
    project = st.Project()
    paths = sorted((SOURCES / folder).iterdir()) + ([STUBS] if folder == "tia" else [])
    texts = [path.read_text() for path in paths]
    for path, text in zip(paths, texts):
        expect(text.isascii() and "\t" not in text, True, f"{path.name} has only what editors of PLCs import safely")
    texts = [text if path.suffix == ".st" else st.from_scl(text) for path, text in zip(paths, texts)]
    # The parser needs seconds for a long source.
    for path, text, items in zip(paths, texts, processes.map(st.parse, map(str, paths), texts)):
        declared = re.search(r"(?m)^(?:TYPE|FUNCTION_BLOCK|PROGRAM) (\w+)", text).group(1)
        expect(declared == path.stem or path == STUBS, True, f"{path.name} declares {declared}")
        project.add(path, items)
    if folder == "tia":
        project.globals["db_wsg"] = [("struct", "db_wsg"), None]
    project.link()
    for variable in project.globals.values():
        variable[1] = project.new(variable[0])
    projects[folder] = project


def statements(path):
    """The statements of a source, without comments and spaces."""
    text = path.read_text()
    bare = re.sub(r"(?s)\(\*.*?\*\)", "", text if path.suffix == ".st" else st.from_scl(text))
    return bare[bare.rindex("END_VAR") :].split()


def compare(codesys, tia):
    """TIA Portal and CODESYS get the same blocks: the tests below run most of them for CODESYS only."""
    for name, fields in codesys.structs.items():
        expect(list(tia.structs[name].items()), list(fields.items()), f"fields of {name}")
    for path in (SOURCES / "codesys").glob("FB_*.st"):
        one, other = codesys.blocks[path.stem.lower()], tia.blocks[path.stem.lower()]
        kinds = [[(name, var.kind, var.type) for name, var in block.vars.items()] for block in (one, other)]
        expect(kinds[1], kinds[0], f"variables of {path.stem} for TIA Portal")
        frames = [project.new(("fb", path.stem.lower())) for project in (codesys, tia)]
        values = [{k: v for k, v in frame.items() if not isinstance(v, (dict, st.Block))} for frame in frames]
        expect(values[1], values[0], f"initial values of {path.stem} for TIA Portal")
        expect(statements(SOURCES / "tia" / f"{path.stem}.scl"), statements(path), f"statements of {path.stem}")
    examples = statements(SOURCES / "codesys" / "PRG_Example.st"), statements(SOURCES / "tia" / "FB_WsgExample.scl")
    # They exchange their registers in different ways.
    one, other = (words[words.index("bAckEdge") : -1] for words in examples)
    expect(other, one, "statements of the example")


def run(path, scenario, project, **parameters):
    gateway = Gateway(path)
    try:
        scenario(Plc(project, gateway, **parameters))
    finally:
        gateway.stop()


def attempt(name, test, *args, **parameters):
    try:
        test(*args, **parameters)
    except Exception as error:
        print(f"test {name} ... FAILED\n{type(error).__name__} in {name}: {error}", flush=True)
        return False
    print(f"test {name} ... ok", flush=True)
    return True


def main():
    path, projects = sys.argv[1], {}
    with ProcessPoolExecutor() as processes:
        results = [attempt(f"{folder}::sources", load, projects, processes, folder) for folder in FOLDERS]
    if all(results):
        results.append(attempt("tia::same_as_codesys", compare, projects["codesys"], projects["tia"]))
        tests = [("codesys", scenario, {}) for scenario in SCENARIOS]
        tests += [("codesys", values, {"unit": 2}), ("http", grip_cycle, {"program": "FB_WsgHttpRequest"})]
        tests += [("codesys", test, {"program": "PRG_Example"}) for test in (example, example_with_stop, random_faults)]
        tests.append(("tia", example, {"program": "FB_WsgExample"}))
        # The tests wait for motions most of the time.
        with ThreadPoolExecutor(4) as threads:
            started = [threads.submit(attempt, f"{folder}::{scenario.__name__}", run, path, scenario,
                                      projects[folder], **parameters) for folder, scenario, parameters in tests]
        results += [test.result() for test in started]
    passed, failed = results.count(True), results.count(False)
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(failed > 0)


SCENARIOS = (recipes, one_command_at_a_time, counters, lease, not_taken_up, lost_connection, stopped_program,
             restarted_gateway, restarted_plc, fast_stop, status_bits)

if __name__ == "__main__":
    main()
