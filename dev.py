#!/usr/bin/env python3
"""Every chore of this project behind one file that needs nothing but Python 3.11.

    python3 dev.py run  [ARGS]   dashpot ARGS; without ARGS, identify the example rig
    python3 dev.py test [ARGS]   the tests, a few minutes; --long: those that take longer; other ARGS go to pytest
                                 --slow: those of some seconds as well
                                 --older: these, while BLAS and the kernel compute as on an older processor (x86)
    python3 dev.py check         ruff, mypy and the import contracts
    python3 dev.py bench [NAME]  the benchmarks, all or the named ones; what follows the first -option goes to them
    python3 dev.py env           only make the environment, .venv, with the compiled kernel where it can be built
    python3 dev.py lock [ARGS]   renew requirements/*locked.txt; --upgrade moves every pin
    python3 dev.py lowest [ARGS] the unit tests on the wheel with the lowest versions that pyproject.toml allows;
                                 --python VERSION takes another Python, other ARGS go to pytest
    python3 dev.py newest [ARGS] the same with the newest versions that there are
    python3 dev.py fuzz [ARGS]   damaged inputs of every kind; --minutes N, --inputs N, --seed S
    python3 dev.py docs [--serve] the manual as a site, docs/_build/html; --serve shows it on this machine until Ctrl-C

The first call makes .venv from requirements/locked.txt, every file checked against its hash. `run` begins with what it
needs itself and has the rest installed and the kernel built in the background; every other command waits for them.
Later calls compare a stamp and start at once; a changed lock, another Python or a set-up cut short remakes .venv.
"""

# Kept readable by Pythons from 3.7 on, so that they get the one line of version_complaint, not a SyntaxError.
from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import Any

OLDEST = (3, 11)
ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
STAMP = VENV / "stamp.json"
KERNELS = ROOT / "kernels"
KERNEL_STAMP = VENV / "stamp-kernel.json"
KERNEL_SECONDS = 900  # after which a build is given up
PIP_LOG = VENV / "pip.log"
KERNEL_LOG = VENV / "kernel.log"
REQUIREMENTS = ROOT / "requirements"
LOCKED = REQUIREMENTS / "locked.txt"
RUN_LOCKED = REQUIREMENTS / "run-locked.txt"  # what `run` begins with; the rest comes in the background
PEERS_LOCKED = REQUIREMENTS / "peers-locked.txt"
DOCS_LOCKED = REQUIREMENTS / "docs-locked.txt"
WEB_LOCKED = REQUIREMENTS / "web-locked.txt"
SITE = ROOT / "docs" / "_build" / "html"
EXAMPLE = ["identify", "examples/02_shake_table/rig.toml", "examples/02_shake_table/amplitudes.csv"]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Tests start some hundred processes: where an environment forbids bytecode, each would compile a thousand modules anew.
BYTECODE = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(VENV / "bytecode")}
TESTED = {"MPLBACKEND": "Agg", **ONE_THREAD, **BYTECODE}
# Without bytecode, which the first import writes of what is used: all of it would take as long as the rest.
PIP_INSTALL_LOCKED = ("install", "--no-compile", "--require-hashes", "--only-binary", ":all:", "-r")
COMMANDS = ("run", "test", "check", "bench", "env", "lock", "lowest", "newest", "fuzz", "docs")
# What the tests of `lowest` and `newest` need beside the wheel; the locked set has more than an old NumPy allows.
TESTING = ("pytest>=9", "pytest-xdist", "hypothesis", "import-linter", "lmfit", "openpyxl")


class SetupError(Exception):
    """What is wrong and what to do about it, in one line."""


class UsageError(SetupError):
    """The command line cannot be understood."""


# ---------------------------------------------------------------- pure functions


def dotted(version: Iterable[object]) -> str:
    """3.11 of sys.version_info or (3, 11)."""
    return ".".join(str(n) for n in list(version)[:2])


def version_complaint(version: tuple[Any, ...]) -> str | None:
    """One line when this Python is too old, else None."""
    if version[:2] >= OLDEST:
        return None
    needed = dotted(OLDEST)
    return f"Python {needed} or newer is needed, this is {dotted(version)}: try python{needed} dev.py"


def parse(argv: Sequence[str]) -> tuple[str, list[str]]:
    """The sub-command and what is passed through to the program behind it."""
    if not argv:
        raise UsageError(f"say what to do: python3 dev.py {'|'.join(COMMANDS)}  (--help tells more)")
    command, *extra = argv
    if command in ("-h", "--help"):
        return "help", []
    if command not in COMMANDS:
        raise UsageError(f"no command {command!r}: there are {', '.join(COMMANDS)}")
    if extra and command in ("check", "env"):
        raise UsageError(f"{command} takes no arguments, got {' '.join(extra)}")
    return command, extra


def digest(*parts: str | bytes) -> str:
    """SHA-256 over the parts, each preceded by its length so that moving a boundary changes the result."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        total.update(b"%d:" % len(data) + data)
    return total.hexdigest()


def packages_stamp(locked: bytes, version: Iterable[object], root: str) -> str:
    """What the packages follow from: the lock, Python's minor version, the place (a venv cannot move)."""
    return digest(locked, dotted(version), root)


def project_stamp(pyproject: str) -> str:
    """What the editable install follows from: metadata and build settings, not the settings of linters."""
    import tomllib

    table = tomllib.loads(pyproject)
    used = [table.get("project"), table.get("build-system"), table.get("tool", {}).get("hatch")]
    return digest(json.dumps(used, sort_keys=True))


def extras_of(pyproject: str) -> list[str]:
    """Names of the optional dependencies that come from a registry; the compiled kernel is built from its sources."""
    import tomllib

    extras = tomllib.loads(pyproject)["project"]["optional-dependencies"]
    return [name for name in extras if name not in ("fast", "web")]  # only long tests need the page


def pip_complaint(output: str) -> str:
    """pip's pages of output as one line with a cure."""
    for signs, answer in (
        (
            ("DO NOT MATCH THE HASHES",),
            "a download does not match its hash in the lock: try again, and distrust the mirror if it stays so",
        ),
        (("No space left", "Errno 28"), "the disk is full: make room for about 1 GB"),
        (
            ("connection broken", "Max retries", "ConnectionError", "Temporary failure", "ProxyError"),
            "the package index cannot be reached: check the network and pip's settings (pip config list)",
        ),
    ):
        if any(sign in output for sign in signs):
            return answer
    lines = output.splitlines()
    for line in lines:
        if "No matching distribution found for" in line:
            wanted = line.split(" for ")[-1].split(" (")[0]
            return f"no ready-made wheel of {wanted} for this Python and platform: try another Python"
    errors = [line.strip() for line in lines if line.lstrip().upper().startswith("ERROR")]
    return errors[-1] if errors else "pip failed"


def addresses_in(locked: str) -> list[str]:
    """Lines of a lock file that name a place instead of a package."""
    signs = ("://", "--index-url", "--extra-index-url", "--find-links", "file:", " @ ")
    return [line for line in locked.splitlines() if any(sign in line for sign in signs)]


def split_bench(extra: Sequence[str], known: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of benchmarks to run (all when none is given), and the options for them."""
    first = next((i for i, word in enumerate(extra) if word.startswith("-")), len(extra))
    names = [Path(word).stem for word in extra[:first]]
    for name in names:
        if name not in known:
            raise UsageError(f"no benchmark {name!r}: there are {', '.join(known) if known else 'none yet'}")
    return names or list(known), list(extra[first:])


def split_python(extra: Sequence[str]) -> tuple[str, list[str]]:
    """The Python asked for by --python, this one unless given, and the other arguments."""
    words = list(extra)
    if "--python" not in words:
        return getattr(sys, "_base_executable", None) or sys.executable, words
    at = words.index("--python")
    if at + 1 == len(words):
        raise UsageError("--python needs a version or a path, such as 3.13")
    return words[at + 1], words[:at] + words[at + 2 :]


def older_processor(flags: Iterable[str]) -> dict[str, str]:
    """What makes BLAS and the kernel compute as on the generation before this x86 processor."""
    if "avx512f" in flags:
        return {"OPENBLAS_CORETYPE": "Haswell", "DASHPOT_KERNEL_SET": "avx2"}
    if "avx2" in flags:
        return {"OPENBLAS_CORETYPE": "Prescott", "DASHPOT_KERNEL_SET": "baseline"}
    raise SetupError("no older processor is known that this one can stand for: leave --older out")


def child_environment(base: Mapping[str, str], extra: Mapping[str, str]) -> dict[str, str]:
    """The caller's environment without what would mix other packages into .venv or make pip ask questions."""
    mixing = ("PYTHONPATH", "PYTHONHOME", "PIP_TARGET", "PIP_PREFIX")
    quiet = {"PIP_USER": "0", "PIP_NO_INPUT": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    return {**{name: value for name, value in base.items() if name not in mixing}, **quiet, **extra}


# ---------------------------------------------------------------- the environment


def say(text: str) -> None:
    print(f"dev.py: {text}", file=sys.stderr, flush=True)


def call(command: Sequence[str | Path], cwd: Path | None = None, **variables: str) -> int:
    """Run to the end, return the exit code as a shell would."""
    process = subprocess.Popen(
        [str(word) for word in command],
        cwd=cwd,
        env=child_environment(os.environ, variables),
        stdin=subprocess.DEVNULL if sys.stdin is None else None,
    )
    while True:
        try:
            code = process.wait()
            return code if code >= 0 else 128 - code
        except KeyboardInterrupt:
            continue  # the child got it too and decides how to end
        except SystemExit:
            process.terminate()


def quietly(command: Sequence[str | Path], seconds: float | None = None) -> str:
    """Run, return the output; SetupError carries it when the command fails, or takes longer than `seconds`."""
    try:
        done = subprocess.run(
            [str(word) for word in command],
            cwd=ROOT,
            env=child_environment(os.environ, {}),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            close_fds=False,  # the child shares the lock of only_one, which so outlives a killed dev.py
            text=True,
            errors="replace",
            timeout=seconds,
        )
    except subprocess.TimeoutExpired as slow:
        raise SetupError(f"ERROR: not done after {slow.timeout:g} s") from slow
    if done.returncode:
        raise SetupError(done.stdout)
    return done.stdout


def pip(python: Path, *arguments: str | Path) -> None:
    """Run pip; where it fails, what it said is kept (its own --log, of every link, is a fifth of its time)."""
    try:
        quietly([python, "-m", "pip", *arguments])
    except SetupError as failure:
        with contextlib.suppress(OSError):
            PIP_LOG.write_text(str(failure), encoding="utf-8")
        details = f" (pip's own words: {PIP_LOG})" if PIP_LOG.exists() else ""
        raise SetupError(pip_complaint(str(failure)) + details) from failure


def make_venv(place: Path) -> None:
    # From the base interpreter: dev.py may itself be run by the .venv that is about to be replaced.
    python = getattr(sys, "_base_executable", None) or sys.executable
    try:
        quietly([python, "-m", "venv", place])
    except SetupError as failure:
        raise SetupError(
            "this Python cannot make a virtual environment: install its venv module (apt install python3-venv)"
        ) from failure


@contextlib.contextmanager
def only_one(path: Path, wait: bool = True) -> Iterator[None]:
    """Hold off other dev.py of this clone.  The system frees the lock when its last holder dies.

    Raises OSError where another one holds it and `wait` is false.
    """
    with path.open("a+b") as file:
        os.set_inheritable(file.fileno(), True)
        if sys.platform == "win32":
            import msvcrt
            import time

            def attempt(wait: bool) -> None:
                while True:
                    try:
                        file.seek(0)
                        return msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
                    except OSError:
                        if not wait:
                            raise
                        time.sleep(0.2)
        else:
            import fcntl

            def attempt(wait: bool) -> None:
                fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)

        try:
            attempt(wait=False)
        except OSError:
            if not wait:
                raise
            say("another dev.py is setting up this clone, waiting for it")
            attempt(wait=True)
        yield


def read_stamp(path: Path) -> dict[str, str]:
    """What a finished set-up left; empty when there is none or it is unreadable."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def write_stamp(path: Path, stamp: Mapping[str, str]) -> None:
    """In one step, so that a stamp is whole or absent."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(stamp), encoding="utf-8")
    os.replace(part, path)


def wanted_stamp(locked: Path) -> dict[str, str]:
    return {
        "packages": packages_stamp(locked.read_bytes(), sys.version_info, str(ROOT)),
        "project": project_stamp((ROOT / "pyproject.toml").read_text(encoding="utf-8")),
    }


def ready(*locks: Path) -> bool:
    return PYTHON.exists() and any(read_stamp(STAMP) == wanted_stamp(locked) for locked in locks)


def make_environment(*, begin: bool = False) -> None:
    """Make .venv follow the lock and pyproject.toml; nothing to do when its stamp says it does.

    To `begin`, what `run` needs is enough; the rest is added to it, also while it is used.
    """
    enough = (LOCKED, RUN_LOCKED) if begin else (LOCKED,)
    if ready(*enough):
        return
    with only_one(ROOT / ".venv.lock"):
        if ready(*enough):
            return
        locked = enough[-1]
        wanted = wanted_stamp(locked)
        packages = read_stamp(STAMP).get("packages") if PYTHON.exists() else None
        if packages == wanted["packages"]:
            say("pyproject.toml has changed, installing the project again")
        elif packages == wanted_stamp(RUN_LOCKED)["packages"]:
            say("adding what requirements/locked.txt has beside it to .venv, about a minute")
            pip(PYTHON, *PIP_INSTALL_LOCKED, locked)
        else:
            say(
                f"making .venv from requirements/{locked.name}, {'half a minute' if begin else 'a minute or two'}"
            )
            # The stamp goes first and comes last: whatever cuts this short leaves an environment that is remade.
            STAMP.unlink(missing_ok=True)
            if VENV.is_symlink():
                VENV.unlink()
            elif VENV.exists():
                shutil.rmtree(VENV)
            make_venv(VENV)
            pip(PYTHON, *PIP_INSTALL_LOCKED, locked)
        pip(PYTHON, "install", "--no-deps", "--no-build-isolation", "--no-index", "-e", ROOT)
        try:
            quietly([PYTHON, "-m", "pip", "check"])
        except SetupError as failure:
            gap = str(failure).partition("\n")[0]
            raise SetupError(
                f"the lock lacks what pyproject.toml asks for ({gap}): python3 dev.py lock"
            ) from failure
        write_stamp(STAMP, wanted)


def kernel_stamp(sources: Iterable[Path], compiler: str, packages: str) -> str:
    """What the compiled kernel follows from: its sources, the compiler, the environment it is built in."""
    parts = [part for path in sorted(sources) for part in (path.name, path.read_bytes())]
    return digest(*parts, compiler, packages)


def kernel_sources() -> list[Path]:
    """Every file that the kernel is built from."""
    kept = (".toml", ".txt", ".hpp", ".cpp", ".py")
    return [path for path in KERNELS.rglob("*") if path.is_file() and path.suffix in kept]


def find_compiler() -> str | None:
    """The C++ compiler of this machine: CXX, or what is on the path."""
    asked = os.environ.get("CXX")
    names = [asked] if asked else ["c++", "g++", "clang++"]
    return next((place for name in names if (place := shutil.which(name))), None)


def wanted_kernel(compiler: str | None) -> dict[str, str]:
    packages = read_stamp(STAMP).get("packages", "")
    return {"kernel": kernel_stamp(kernel_sources(), str(compiler), packages)}


def finish_in_background() -> None:
    """Let a process of its own install the rest and build the kernel while this one goes on.

    Other commands wait for it by the lock.
    """
    complete, compiler = ready(LOCKED), find_compiler()
    if complete and compiler is None:
        install_kernel()  # says so, once
        return
    if complete and read_stamp(KERNEL_STAMP) == wanted_kernel(compiler):
        return
    what = [] if complete else ["the other packages are being installed"]
    what += (
        [] if compiler is None else ["the compiled kernel is being built (until then NumPy does its work)"]
    )
    say(f"in the background {' and '.join(what)}: {KERNEL_LOG}")
    try:
        with only_one(ROOT / ".venv.lock", wait=False):
            pass
    except OSError:
        return  # being built already
    nice = ["nice", "-n", "19"] if shutil.which("nice") else []
    with KERNEL_LOG.open("a") as log:
        subprocess.Popen(
            [*nice, sys.executable, __file__, "env"],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def install_kernel() -> None:
    """Build and install the compiled kernel; whatever stands in the way is told in one line, and all works without."""
    compiler = find_compiler()
    wanted = wanted_kernel(compiler)
    if read_stamp(KERNEL_STAMP) == wanted:
        return
    with only_one(ROOT / ".venv.lock"):
        if read_stamp(KERNEL_STAMP) == wanted:
            return
        KERNEL_STAMP.unlink(missing_ok=True)
        if compiler is None:
            say(
                "going on without the compiled kernel: there is no C++ compiler (NumPy does its work, more slowly)"
            )
        if compiler is None or build_kernel():
            write_stamp(KERNEL_STAMP, wanted)


def build_kernel() -> bool:
    """Whether the build ended by itself: one that failed would fail again, one that took too long may not."""
    say("building the compiled kernel, about a minute")
    command: list[str | Path] = [
        PYTHON, "-m", "pip", "--log", PIP_LOG, "install", "--no-deps", "--no-build-isolation", "--no-index",
        "--force-reinstall", KERNELS,
    ]  # fmt: skip
    try:
        quietly(command, seconds=KERNEL_SECONDS)
    except SetupError as failure:
        with contextlib.suppress(SetupError):  # nor one of other sources
            quietly([PYTHON, "-m", "pip", "uninstall", "--yes", "dashpot-kernels"])
        reason = pip_complaint(str(failure))
        say(
            f"going on without the compiled kernel: it could not be built: {reason} (pip's own words: {PIP_LOG})"
        )
        return not isinstance(failure.__cause__, subprocess.TimeoutExpired)
    return True


def install_beside(locked: Path, what: str) -> str:
    """Add the packages of another lock to .venv; why not, where that fails, and else nothing."""
    stamp = VENV / f"stamp-{locked.stem.partition('-')[0]}.json"
    wanted = {"packages": digest(locked.read_bytes())}
    if read_stamp(stamp) == wanted:
        return ""
    with only_one(ROOT / ".venv.lock"):
        say(f"installing {what}, requirements/{locked.name}")
        try:
            pip(PYTHON, *PIP_INSTALL_LOCKED, locked)
        except SetupError as failure:
            return str(failure)
        write_stamp(stamp, wanted)
    return ""


def install_peers() -> None:
    """Peers of the benchmarks that not every machine can have; without them their benchmarks say so."""
    failure = install_beside(PEERS_LOCKED, "the peers of the benchmarks")
    if failure:
        say(f"going on without the peers of requirements/peers.in: {failure}")


# ---------------------------------------------------------------- the commands


def run(extra: list[str]) -> int:
    if extra:
        return call([BIN / "dashpot", *extra])
    return call([BIN / "dashpot", *EXAMPLE], cwd=ROOT)


def processor_flags() -> set[str]:
    """What this processor can do, as Linux names it; empty elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


def test(extra: list[str]) -> int:
    if "--long" in extra:
        for locked, what, tests in (
            (DOCS_LOCKED, "what builds the manual", "the manual"),
            (WEB_LOCKED, "what serves the page", "the page"),
        ):
            failure = install_beside(locked, what)
            if failure:
                say(f"going on without the tests of {tests}: {failure}")
    variables = dict(TESTED)
    if "--older" in extra:
        extra = ["--slow", *(word for word in extra if word != "--older")]
        older = older_processor(processor_flags())
        say(f"computing as on an older processor: {' '.join(f'{k}={v}' for k, v in older.items())}")
        variables.update(older)
    # One BLAS thread in each worker: two workers with two threads each fight over two cores.
    # worksteal keeps neighbouring tests together, so fixtures of a module are mostly made once.
    return call(
        [PYTHON, "-m", "pytest", "-q", "-n", "2", "--dist", "worksteal", *extra], cwd=ROOT, **variables
    )


def check(_: list[str]) -> int:
    chores: dict[str, list[str | Path]] = {
        "ruff check": [PYTHON, "-m", "ruff", "check", "--output-format", "concise", "."],
        "ruff format": [PYTHON, "-m", "ruff", "format", "--check", "--output-format", "concise", "."],
        "mypy": [PYTHON, "-m", "mypy"],
        "import contracts": [BIN / "lint-imports"],
    }
    failed = []
    for name, command in chores.items():
        print(f"--- {name}", flush=True)
        if call(command, cwd=ROOT):
            failed.append(name)
    print(f"--- failed: {', '.join(failed)}" if failed else "--- all checks passed", flush=True)
    return 1 if failed else 0


def bench(extra: list[str]) -> int:
    known = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if not path.name.startswith("_"))
    names, options = split_bench(extra, known)
    install_peers()
    worst = 0
    for name in names:
        print(f"--- {name}", flush=True)
        worst = max(worst, call([PYTHON, ROOT / "benchmarks" / f"{name}.py", *options], cwd=ROOT))
    if not names:
        say("there are no benchmarks yet")
    return worst


def fuzz(extra: list[str]) -> int:
    return call([PYTHON, "-m", "tests.fuzz", *extra], cwd=ROOT, **TESTED)


def docs(extra: list[str]) -> int:
    if [word for word in extra if word != "--serve"]:
        raise UsageError(f"docs takes --serve only, got {' '.join(extra)}")
    failure = install_beside(DOCS_LOCKED, "what builds the manual")
    if failure:
        raise SetupError(failure)
    code = call([PYTHON, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", SITE], cwd=ROOT)
    if code == 0:
        say(f"the manual is {(SITE / 'index.html').relative_to(ROOT)}")
    if code or "--serve" not in extra:
        return code
    return call([PYTHON, "-m", "http.server", "--bind", "127.0.0.1", "--directory", SITE, "8000"])


def other_versions(which: str, extra: list[str]) -> int:
    """The wheel and the tests in an environment of their own: the lowest versions declared, or the newest there are."""
    version, extra = split_python(extra)
    place = ROOT / f".venv-{which}"
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix=f"dashpot-{which}-")))
        make_venv(folder / "tools")
        tools = folder / "tools" / BIN.name
        pip(tools / PYTHON.name, "install", "uv")
        uv, python = tools / "uv", place / BIN.name / PYTHON.name
        resolution = ["--resolution", "lowest-direct" if which == "lowest" else "highest"]
        try:
            quietly([uv, "venv", "--quiet", "--clear", "--no-python-downloads", "--python", version, place])
            quietly([uv, "build", "--quiet", "--wheel", "--out-dir", folder, ROOT])
            (wheel,) = folder.glob("*.whl")
            install: list[str | Path] = [
                uv,
                "pip",
                "install",
                "--quiet",
                "--python",
                python,
                "--only-binary",
                ":all:",
            ]
            # From pyproject.toml, not from the wheel, whose own dependencies would not count as direct.
            # But for the extra of the compiled kernel, which is built from this clone.
            extras = [
                word
                for name in extras_of((ROOT / "pyproject.toml").read_text())
                for word in ("--extra", name)
            ]
            quietly([*install, *resolution, "-r", "pyproject.toml", *extras])
            quietly([*install, "--no-deps", wheel])
            kept = quietly([uv, "pip", "freeze", "--quiet", "--python", python, "--exclude-editable"])
            constraints = folder / "constraints.txt"
            constraints.write_text("".join(f"{one}\n" for one in kept.splitlines() if "==" in one))
            quietly([*install, "--constraints", constraints, *TESTING])
        except SetupError as failure:
            raise SetupError(" ".join(str(failure).split())) from failure
        shown = quietly([uv, "pip", "list", "--quiet", "--python", python])
    print(shown, flush=True)
    # Old versions warn of what newer ones have changed, and newest ones of what they will: here only failures count.
    options = [
        "-q",
        "-n",
        "2",
        "--dist",
        "worksteal",
        "-p",
        "no:cacheprovider",
        "-o",
        "filterwarnings=default",
        "--slow",
    ]
    tests = (
        extra
        if any(not word.startswith("-") for word in extra)
        else [*extra, "tests/unit", "tests/repository"]
    )
    return call([python, "-m", "pytest", *options, *tests], cwd=ROOT, MPLBACKEND="Agg", **ONE_THREAD)


def lock(extra: list[str]) -> int:
    options = (
        f"--quiet --universal --python-version {dotted(OLDEST)} --generate-hashes --no-header --no-annotate"
    )
    with tempfile.TemporaryDirectory(prefix="dashpot-lock-") as folder:
        place = Path(folder)
        make_venv(place)
        binaries = place / BIN.name
        pip(binaries / PYTHON.name, "install", "uv")
        for output, inputs in (
            (LOCKED, ["pyproject.toml", "requirements/dev.in"]),
            (
                RUN_LOCKED,
                ["pyproject.toml", "requirements/run.in", "--constraints", "requirements/locked.txt"],
            ),
            (PEERS_LOCKED, ["requirements/peers.in", "--constraints", "requirements/locked.txt"]),
            (DOCS_LOCKED, ["requirements/docs.in", "--constraints", "requirements/locked.txt"]),
            (
                WEB_LOCKED,
                [
                    "requirements/web.in",
                    "--constraints",
                    "requirements/locked.txt",
                    "--constraints",
                    "requirements/docs-locked.txt",
                ],
            ),
        ):
            target = output.relative_to(ROOT)
            code = call(
                [binaries / "uv", "pip", "compile", *options.split(), *extra, *inputs, "-o", target], cwd=ROOT
            )
            if code:
                return code
            named = addresses_in(output.read_text(encoding="utf-8"))
            if named:
                raise SetupError(f"{target} names a place, which must not be committed: {named[0].strip()}")
            say(f"{target} is up to date")
    return 0


def main(argv: Sequence[str]) -> int:
    complaint = version_complaint(sys.version_info)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that children end with us
    try:
        if complaint is not None:
            raise SetupError(complaint)
        command, extra = parse(argv)
        if command == "help":
            print(__doc__)
            return 0
        if command == "lock":
            return lock(extra)
        if command in ("lowest", "newest"):
            return other_versions(command, extra)
        make_environment(begin=command == "run")
        if command == "run":
            finish_in_background()
        else:
            install_kernel()
        if command == "env":
            return 0
        commands = {"run": run, "test": test, "check": check, "bench": bench, "fuzz": fuzz, "docs": docs}
        return commands[command](extra)
    except SetupError as failure:
        say(str(failure))
        return 2
    except OSError as failure:
        say(f"{failure.filename or 'system'}: {failure.strerror or failure}")
        return 2
    except KeyboardInterrupt:
        say("interrupted; the next call goes on from a clean state")
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
