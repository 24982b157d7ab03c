"""Try the wheel as a person gets it: in an environment of its own, away from the checkout.

    python .ci/try_wheel.py dist [--plain]

Every file of ``src`` must be in the wheel and in the source package. The plain install must do a real job and say,
where it needs an extra, which; with all extras the same commands must pass, which ``--plain`` leaves out.
"""

from __future__ import annotations

import html
import http.client
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import urllib.parse
import urllib.request
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MAKE_MOTIONS = """
import sys
from pathlib import Path
import dousa
from dousa.motion.synthetic.performers import make_library
assert Path(dousa.__file__).is_relative_to(sys.prefix), dousa.__file__
for category, performer, take, motion in make_library(4, 1, 0, ["kick_left", "squat", "wave_right"]):
    folder = Path("query" if performer.name.endswith("03") else "made") / category
    folder.mkdir(parents=True, exist_ok=True)
    dousa.write_motion(motion, folder / f"{performer.name}.bvh")
"""
QUERY = "query/kick_left/performer03.bvh"
MODEL = "made/kick_left/performer01.bvh"

# What a plain install does.
PLAIN = (
    "--version",
    "--help",
    "add moves.dousa made --performer-from path:(performer..)",
    f"add moves.dousa --takes {QUERY}",
    "train moves.dousa --trees 20",
    f"search moves.dousa {QUERY} -k 3 --explain",
    f"classify moves.dousa {QUERY} --json",
    f"find moves.dousa {MODEL}",
    f"label moves.dousa {QUERY}",
    f"evaluate {MODEL} --performance {QUERY} --json",
    f"--lang ja evaluate {MODEL} --performance {QUERY} -o report",
    f"convert {QUERY} query.trc",
    "info query.trc",
    "keypoints --json",
    f"render {QUERY} --ring 3 --size 120x90 --frames 0:12 -o seen.npz",
)
# What needs an extra, and which.
EXTRA = (
    (f"plot {QUERY} -o sheet.png", "pictures"),
    (f"search moves.dousa {QUERY} --picture found.png", "pictures"),
    (f"label moves.dousa {QUERY} --picture labels.svg", "pictures"),
    ("demo -o demo", "pictures"),
    ("estimate seen.npz --stature 1.7 -o estimated.bvh", "film"),
    ("studio moves.dousa --no-browser", "studio"),
)


def check_contents(folder: Path) -> Path:
    """The wheel, after a look that nothing of ``src`` is left out of it or of the source package."""
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    answer = subprocess.run(["git", "ls-files", "src"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    wanted = {name.removeprefix("src/") for name in answer.splitlines() if (ROOT / name).exists()}
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = set(archive.namelist())
    with tarfile.open(source) as archive:
        in_source = {name.partition("/src/")[2] for name in archive.getnames()}
    for package, inside in ((wheel, in_wheel), (source, in_source)):
        missing = sorted(wanted - inside)
        if missing:
            sys.exit(f"{package.name} lacks {len(missing)} files of src: {', '.join(missing[:20])}")
        print(f"{package.name}: all {len(wanted)} files, {package.stat().st_size / 1e6:.1f} MB")
    return wheel


class _LocalConnection(http.client.HTTPConnection):
    """A connection to this machine, whatever the name: browsers know the names below localhost, not every system."""

    def connect(self) -> None:
        self.host = "127.0.0.1"
        super().connect()


class _LocalHandler(urllib.request.HTTPHandler):
    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_LocalConnection, req)


class Environment:
    """A fresh environment, and an empty folder to work in, both below one folder."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder / "venv", with_pip=True)
        self.programs = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
        self.work = folder / "work"
        self.work.mkdir()
        self.variables = {name: text for name, text in os.environ.items() if not name.startswith(("PYTHON", "COV"))}

    def run(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        """A program of the environment, run in its folder: what came of it."""
        command = [self.programs / words[0], *words[1:]]
        return subprocess.run(command, check=False, cwd=self.work, env=self.variables, capture_output=True, text=True)

    def must(self, *words: str | Path) -> None:
        """The same, and the end where it fails."""
        outcome = self.run(*words)
        if outcome.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: exit code {outcome.returncode}\n{outcome.stdout}{outcome.stderr}")

    def visit(self, *words: str) -> None:
        """Start the studio, open its pages with what they load, and stop it."""
        command = [self.programs / words[0], *words[1:]]
        with subprocess.Popen(command, cwd=self.work, env=self.variables, stderr=subprocess.PIPE, text=True) as studio:
            assert studio.stderr is not None
            try:
                said = studio.stderr.readline()
                address = re.search(r"http://\S+", said)
                if address is None:
                    sys.exit(f"{' '.join(words)}: expected the address of the studio, got {said}")
                cookies = urllib.request.HTTPCookieProcessor()
                browser = urllib.request.build_opener(urllib.request.ProxyHandler({}), _LocalHandler, cookies)
                answer = browser.open(address[0], timeout=60)
                page = answer.read().decode()
                for link in sorted(set(re.findall(r'(?:href|src)="(/[^"#]*)"', page))):
                    browser.open(urllib.parse.urljoin(answer.url, html.unescape(link)), timeout=60).read()
            finally:
                studio.terminate()

    def install(self, what: str) -> None:
        """Install with the versions that were tested together; of what is never imported nothing is compiled."""
        quiet = ("--quiet", "--disable-pip-version-check", "--no-compile")
        self.must("python", "-m", "pip", "install", *quiet, "-c", ROOT / "constraints.txt", what)

    def lend_kernels(self) -> int:
        """Let it read the kernels that the tests have compiled of the same source; how many modules have some.

        All of them take two minutes, and are compiled here as they are there; those that read files are left to be.
        """
        (home,) = self.programs.parent.rglob("site-packages/dousa")
        count = 0
        for cache in sorted((ROOT / "src" / "dousa").rglob("__pycache__")):
            room = cache.parent.relative_to(ROOT / "src" / "dousa")
            for source in sorted(cache.parent.glob("*.py")) if room.parts[:1] != ("formats",) else ():
                # The list of a module's kernels comes first: what it names is there, also while tests add to it.
                kept = [path for end in ("nbi", "nbc") for path in sorted(cache.glob(f"{source.stem}.*.{end}"))]
                theirs = home / room / source.name
                if kept and theirs.read_bytes() == source.read_bytes():
                    (theirs.parent / cache.name).mkdir(exist_ok=True)
                    for path in kept:
                        shutil.copy(path, theirs.parent / cache.name)
                    shutil.copystat(source, theirs)  # a kernel is that of a file of this age
                    count += 1
        return count


def main() -> None:
    """Look into the packages, install the wheel, do the job; with all extras once more what needs one."""
    wheel = check_contents(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        fresh = Environment(Path(folder))
        fresh.install(str(wheel))
        print(f"plain install: kernels of {fresh.lend_kernels()} modules are compiled already")
        fresh.must("python", "-c", MAKE_MOTIONS)
        for line in PLAIN:
            fresh.must("dousa", *line.split())
        print(f"plain install: {len(PLAIN)} commands pass")
        for line, extra in EXTRA:
            outcome = fresh.run("dousa", *line.split())
            remedy = f"pip install 'dousa[{extra}]'"
            if outcome.returncode == 0 or remedy not in " ".join(outcome.stderr.split()):
                sys.exit(f"dousa {line}: expected an error with {remedy}, got {outcome.returncode}: {outcome.stderr}")
        print(f"plain install: {len(EXTRA)} commands say which extra they need")
        if "--plain" in sys.argv[2:]:
            return
        fresh.install(f"{wheel}[all]")
        for line, extra in EXTRA:
            if extra == "studio":
                fresh.visit("dousa", *line.split())
            elif not line.startswith("demo"):  # `make demo` runs it
                fresh.must("dousa", *line.split())
        print("all extras: the same commands pass")


if __name__ == "__main__":
    main()
