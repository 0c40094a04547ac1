#!/usr/bin/env python3
"""Runs the curl commands of README.md's first steps, and compares the answers with those that are printed there.

usage: first_steps.py README.md http://127.0.0.1:PORT
"""

import json
import subprocess
import sys

# Where the README's commands send to; the gateway under test listens on a port of its own.
PRINTED_BASE = "http://127.0.0.1:8080"

# Whose first block of commands is run, in this order, against one gateway.
SECTIONS = ["A first grip", "Many clients, one gripper"]


def steps(readme):
    """The commands and their printed answers: of the first grip, and of what builds on it."""
    blocks = [readme.split(f"## {title}\n", 1)[1].split("```sh\n", 1)[1].split("```", 1)[0] for title in SECTIONS]
    lines = [line for block in blocks for line in block.splitlines() if line and not line.startswith("# ")]
    for command, answer in zip(lines[::2], lines[1::2], strict=True):
        assert command.startswith("curl ") and answer.startswith("> "), (command, answer)
        yield command, json.loads(answer[2:])


def is_same(printed, real):
    """Measured values vary a little from run to run; all others are exact."""
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
