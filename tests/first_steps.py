#!/usr/bin/env python3
"""Runs the shell blocks of a Markdown page against a gateway, and compares the answers with the printed ones.

usage: first_steps.py PAGE.md http://127.0.0.1:PORT

A block begins with ```sh. Lines that begin with `> ` are the answer to the command above them: one line of JSON, of
which only the printed members are compared, or text that the output has to contain. A command without a printed answer
only has to succeed. TOKEN in a command stands for the newest lease token, and any other word in capitals that is a
member of an earlier answer (FAST_STOP_ID) for its newest value. Python programs run afterwards, see guide_programs.py.
Blocks of other languages are not run.
"""

import json
import re
import subprocess
import sys

import guide_programs

# The address in the printed commands; the gateway under test listens on a port of its own.
PRINTED_BASE = "http://127.0.0.1:8080"

# The README's two commands, which start the gateway and these tests.
NOT_RUN = re.compile(r"^(cargo run|tests/run)\b")

TIMEOUT_S = 60


def steps(page):
    """The commands with their printed answers."""
    for block in re.findall(r"^```sh\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
        command, answer = "", []
        for line in block.replace("\\\n", "").splitlines() + [""]:
            if line.startswith("> "):
                answer.append(line[2:])
            elif not line.startswith("#"):
                if command and not NOT_RUN.match(command):
                    yield command, "\n".join(answer)
                command, answer = line.strip(), []
        if command and not NOT_RUN.match(command):
            yield command, "\n".join(answer)


def is_same(printed, real):
    """Whether an answer is the printed one. Measured values vary a little from run to run."""
    if isinstance(printed, float):
        return isinstance(real, (int, float)) and abs(printed - real) < 0.5
    if isinstance(printed, dict):
        return isinstance(real, dict) and all(is_same(value, real.get(key)) for key, value in printed.items())
    if isinstance(printed, list):
        return isinstance(real, list) and len(printed) <= len(real) and all(map(is_same, printed, real))
    return type(printed) is type(real) and printed == real


def parsed(text):
    """The JSON in a text, or None."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return None


def members(answer):
    """All members of an answer by their names, the outermost last."""
    if isinstance(answer, dict):
        for value in answer.values():
            yield from members(value)
        yield from answer.items()
    elif isinstance(answer, list):
        for value in reversed(answer):
            yield from members(value)


def main():
    path, base = sys.argv[1:]
    with open(path, encoding="utf-8") as file:
        page = file.read()
    all_steps = list(steps(page))
    failed, known = 0, {}
    for command, printed in all_steps:
        real = re.sub(r"\b[A-Z][A-Z_]+\b", lambda word: known.get(word[0].lower(), word[0]), command)
        real = real.replace(PRINTED_BASE, base)
        real = re.sub(r"\bcurl ", "curl -sS --max-time 30 ", real)
        ran = subprocess.run(["bash", "-c", real], capture_output=True, text=True, check=False, timeout=TIMEOUT_S)
        answer, expected = parsed(ran.stdout), parsed(printed)
        known.update((name, value) for name, value in members(answer) if isinstance(value, str))
        if expected is not None:
            is_right = is_same(expected, answer)
        else:
            is_right = printed.strip() in ran.stdout and ran.returncode == 0
        print(f"{'ok' if is_right else 'FAILED':6} {command}")
        if not is_right:
            failed += 1
            print(f"       printed: {printed}\n       answer:  {ran.stdout}{ran.stderr}")
    passed, failed_programs = guide_programs.run(page, base)
    passed += len(all_steps) - failed
    failed += failed_programs
    print(f"test result: {path}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
