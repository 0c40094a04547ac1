#!/usr/bin/env python3
"""Watches a gripper, and grips a part: by Zenoh, with `pip install eclipse-zenoh`.

The lease is bound to this program's life: killed while the fingers move, it leaves a gripper in FAST STOP; killed while
it holds a part, it leaves the part held.
"""

import argparse
import json
import os

import zenoh


class Refused(Exception):
    """The gateway's problem: `code` says what is wrong, `detail` what can be done."""

    def __init__(self, problem):
        super().__init__(f"{problem['code']}: {problem['detail']}")
        self.problem = problem


def connect(endpoint):
    """A session that is on the gateway's network alone, and whose end the gateway notices within 2 s."""
    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "transport/link/tx/lease": 2000,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Gripper:
    """One gripper of one gateway, as one client sees it."""

    def __init__(self, session, gateway, name, client):
        self.session, self.client = session, client
        self.key = f"wsg/v1/{gateway}/{name}"
        # Before the lease is taken: behind a router, the gateway binds the lease to this token.
        self.token = session.liveliness().declare_token(f"wsg/v1/{gateway}/client/{client}")
        self.lease = None

    def query(self, what, fields=None):
        """The one answer to a query, or the problem."""
        # A homing may take the gateway's 60 s at most.
        replies = self.session.get(f"{self.key}/{what}", payload=json.dumps(fields or {}), timeout=65.0)
        for reply in replies:
            if reply.ok is not None:
                return json.loads(reply.ok.payload.to_string())
            try:
                problem = json.loads(reply.err.payload.to_string())
            except json.JSONDecodeError:
                problem = {"code": "no_answer", "detail": reply.err.payload.to_string()}
            raise Refused(problem)
        raise Refused({"code": "no_gateway", "detail": f"nobody answers at {self.key}"})

    def command(self, name, *parameters, **fields):
        """A command, by its fields of the HTTP API, with the lease if there is one; waits for its end."""
        if self.lease:
            fields.setdefault("lease", self.lease)
        parameters = ";".join([f"client={self.client}", "wait_ms=60000", *parameters])
        return self.query(f"command/{name}?{parameters}", fields)

    def take_lease(self):
        """From now on nobody else moves it. The lease ends with this session."""
        self.lease = self.command("lease.take", f"zid={self.session.zid()}", holder=self.client)["token"]

    def release_lease(self):
        """The orderly end."""
        self.command("lease.release")
        self.lease = None


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT")
    parser.add_argument("--gateway", default="gateway")
    parser.add_argument("--gripper", default="left")
    parser.add_argument("--width-mm", type=float, default=20.0)
    parser.add_argument("--speed-mm-s", type=float, default=50.0)
    parser.add_argument("--force-n", type=float, default=30.0)
    return parser.parse_args()


def main():
    given = arguments()
    with connect(given.connect) as session:
        gripper = Gripper(session, given.gateway, given.gripper, f"example-{os.getpid()}")

        def show(sample):
            state = json.loads(sample.payload.to_string())
            if state["moving"]:
                print(f"{state['state']:<12} {state['width_mm']} mm {state['force_n']} N", flush=True)

        session.declare_subscriber(f"{gripper.key}/state", show)
        gripper.take_lease()
        if not gripper.query("state")["referenced"]:
            gripper.command("home")
        held = gripper.command("grip", width_mm=given.width_mm, speed_mm_s=given.speed_mm_s, force_n=given.force_n)
        print(f"grip: {held['outcome']}, {held['width_mm']} mm", flush=True)
        gripper.release_lease()


if __name__ == "__main__":
    main()
