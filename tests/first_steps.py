#!/usr/bin/env python3
"""Runs the curl commands of README.md's first steps, and compares the answers with the printed ones.

usage: first_steps.py README.md http://127.0.0.1:PORT
"""

import json
import subprocess
import sys

# Base URL in the README's commands; the gateway under test listens on another port.
PRINTED_BASE = "http://127.0.0.1:8080"

# Sections whose first block of commands runs, in this order, against one gateway.
SECTIONS = ["A first grip", "Many clients, one gripper"]


def steps(readme):
    """Yields each command with its printed answer."""
    blocks = [readme.split(f"## {title}\n", 1)[1].split("```sh\n", 1)[1].split("```", 1)[0] for title in SECTIONS]
    lines = [line for block in blocks for line in block.splitlines() if line and not line.startswith("# ")]
    for command, answer in zip(lines[::2], lines[1::2], strict=True):
        assert command.startswith("curl ") and answer.startswith("> "), (command, answer)
        yield command, json.loads(answer[2:])


def is_same(printed, real):
    """Compares measured values (floats) with a tolerance, and all others exactly."""
    if isinstance(printed, float):
        return isinstance(real, (int, float)) and abs(printed - real) < 0.5
    return type(printed) is type(real) and printed == real


def main():
    readme, base = sys.argv[1:]
    failed, token = 0, ""
    with open(readme, encoding="utf-8") as file:
        all_steps = list(steps(file.read()))
    assert len(all_steps) > 5, "the README's first steps were not found"
    for command, printed in all_steps:
        command = command.replace(PRINTED_BASE, base).replace("TOKEN", token)
        ran = subprocess.run(["bash", "-c", command.replace("curl ", "curl -sS --max-time 30 ", 1)],
                             capture_output=True, text=True, check=False)
        try:
            answer = json.loads(ran.stdout)
        except json.JSONDecodeError:
            answer = {}
        token = answer.get("token", token)
        wrong = {key: answer.get(key) for key, value in printed.items() if not is_same(value, answer.get(key))}
        print(f"{'FAILED' if wrong else 'ok':6} {command}")
        if wrong:
            failed += 1
            print(f"       printed: {printed}\n       wrong:   {wrong}\n       answer:  {ran.stdout}{ran.stderr}")
    print(f"test result: first steps. {len(all_steps) - failed} passed; {failed} failed; 0 ignored")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
