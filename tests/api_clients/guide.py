"""Runs the commands and programs of the guide about generated clients, against a gateway with simulated grippers.

usage: guide.py GUIDE PLACE URL, in the directory of the tools. Prints the result of each language.
"""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import openapi_generator_cli

SERVED = "http://127.0.0.1:8080"
JAR = Path(openapi_generator_cli.__file__).with_name("openapi-generator.jar")
# The generator's file has Jackson inside; Debian has the annotations.
JAVA_CLASSES = f"classes:{JAR}:/usr/share/java/jakarta-annotation-api.jar"
# Commands in place of Maven, which the guide leaves to the reader.
FURTHER = {
    "Java": [
        f"javac -nowarn -d classes -cp {JAVA_CLASSES} Main.java $(find wsg/src/main -name '*.java')",
        f"java -cp {JAVA_CLASSES} Main",
    ],
}
NOT_RUN = {"C#"}

guide, place, url = Path(sys.argv[1]), Path(sys.argv[2]).resolve(), sys.argv[3]
tools = Path.cwd()


def blocks(section: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", section, re.MULTILINE | re.DOTALL)


def go_proxy() -> str:
    """Writes the one module that the Go client needs as a module proxy, for a machine that does not reach the real one."""
    proxy = place / "go-proxy"
    versions = proxy / "gopkg.in/validator.v2/@v"
    versions.mkdir(parents=True)
    name, module = "v2.0.1", "module gopkg.in/validator.v2\n"
    (versions / "list").write_text(f"{name}\n")
    (versions / f"{name}.info").write_text(f'{{"Version": "{name}"}}')
    (versions / f"{name}.mod").write_text(module)
    sources = Path("/usr/share/gocode/src/gopkg.in/validator.v2")
    with zipfile.ZipFile(versions / f"{name}.zip", "w") as archive:
        archive.writestr(f"gopkg.in/validator.v2@{name}/go.mod", module)
        for file in sources.glob("*.go"):
            if not file.name.endswith("_test.go"):
                archive.write(file, f"gopkg.in/validator.v2@{name}/{file.name}")
    return f"https://proxy.golang.org|file://{proxy}"


def run(command: str, directory: Path) -> str:
    environment = {
        **os.environ,
        "PATH": f"{tools}/venv/bin:{tools}/node_modules/.bin:{os.environ['PATH']}",
        "GOPROXY": proxy,
        "GOSUMDB": "off",
        "GOPATH": f"{place}/go",
        "GOCACHE": f"{tools}/go-cache",
        "GOFLAGS": "-modcacherw",
        "GOTOOLCHAIN": "local",
    }
    done = subprocess.run(["bash", "-c", command], cwd=directory, env=environment, text=True, capture_output=True)
    if done.returncode != 0:
        sys.exit(f"{directory.name}: {command}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


def check(language: str, section: str, document: Path) -> None:
    directory = place / language
    directory.mkdir()
    shutil.copy(document, directory / "openapi.json")
    # For Node.js: the packages, and that a program is a module.
    (directory / "node_modules").symlink_to(tools / "node_modules")
    (directory / "package.json").write_text('{"type": "module"}')
    for program in blocks(section, "(?:go|java|python|ts)"):
        name, code = program.split("\n", 1)
        (directory / name.split()[-1]).write_text(code.replace(SERVED, url))
    commands = [line for block in blocks(section, "console") for line in block.splitlines()]
    output = ""
    for command in commands + FURTHER.get(language, []):
        # The tools are installed with fixed versions.
        if not command.startswith("npm install"):
            output = run(command, directory)
    if language in NOT_RUN:
        print(f"{language}: generated, not compiled")
        return
    if output.strip() != "PART_HELD":
        sys.exit(f"{language} printed: {output}")
    print(f"{language}: home, lease, grip, release")


shutil.rmtree(place, ignore_errors=True)
place.mkdir(parents=True)
proxy = go_proxy()
introduction, *sections = re.split(r"^## ", guide.read_text(), flags=re.MULTILINE)
download = blocks(introduction, "console")[0].replace(SERVED, url)
run(download, place)
languages = {section.split("\n", 1)[0]: section for section in sections}
listed = set(re.findall(r"^\| \[(.*?)\]\(#", introduction, re.MULTILINE))
assert listed < set(languages), (listed, set(languages))
for language in sorted(listed):
    check(language, languages[language], place / "openapi.json")
