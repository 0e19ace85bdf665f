"""Cases: a command line and its files, made from a seed, kept as JSON."""

from __future__ import annotations

import base64
import hashlib
import json
import random
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import click

from dashpot.app.options import InputFile, OutputFile, OutputFolder
from tests.fuzz import corpus, mutation

# Sound values of options, by the parameter's name; any other option gets one that suits none in particular.
SOUND: dict[str, tuple[str, ...]] = {
    "methods": ("ls,wls", "wls,oiv", "ml"), "truth": ("m1=3,c1=20", "m1=3"), "profiled": ("m1", "c1,c2"),
    "values": ("m1=3,c1=20,c2=30", "m1=3"), "settings": ("m1=3", "c1=20,c2=30"), "frequencies": ("1,2,5",
    "1:10/5", "1:9:2"),
    "amplitudes": ("u=0.01", "1mm"), "amplitude": ("1mm", "u=1mm"), "samples": ("16", "60"), "time": ("10min", "90s"),
    "target": ("1%", "c2=2%"), "aim": ("all", "worst", "volume", "c2,m1"), "sensors": ("pick 1 of x1,x2",),
    "against": ("1,2,5", "1:10/5", "amplitudes.csv"), "after": ("amplitudes.csv", "estimate.json"),
    "estimate_file": ("estimate.json",), "modal_file": ("modes.csv", "modes.json"), "band": ("1:12",),
    "drives": ("u",),
    "stroke": ("5mm",), "max_velocity": ("0.5m/s",), "max_acceleration": ("2gn",), "max_force": ("100N",),
    "doubt": ("30%",), "level": ("95", "90%"), "frequency": ("2", "3Hz"), "orders": ("1", "1,3"),
    "harmonics": ("auto", "2,3"),
    "settle": ("auto", "none", "0.5s"), "relative_noise": ("5%",), "rate": ("100",), "grid": ("0.5",),
    "periods": ("5",),
    "max_frequencies": ("4",), "min_dwell": ("1s",), "seed": ("1",), "draws": ("2",), "processes": ("1",),
}  # fmt: skip
QUANTITIES = (
    "5mm",
    "4.6 kN/m",
    "5 %",
    "1:10:0.5",
    "1:10/25",
    "1,2,5 Hz",
    "90s",
    "100 mV/g",
    "0.5:25",
    "2 gn",
    "3rpm",
)
EXTREMES = (
    *mutation.NUMBERS, *mutation.NAMES[:40], "1:2:3:4", "1:1e9:1e-9", "1e12", "1e200", "1e308", "5%", "1e308%", "-5%",
    "1:10/1e9", "m1=1e200", "m1=nan", "m1=-3", "u=1e308", "100%", "0%", "1e-300", "pick 9 of x1", "pick 1 of",
    "1e200mm",
    "1e308N", "3 bananas", "auto", "none", "2,2,2", "1e3h", "rig.toml", "amplitudes.csv", "/dev/null", ".",
    "no/such/file",
)  # fmt: skip
READINGS = 0.85  # share of the cases that only read
# How often each command comes: those that compute little come often.
WEIGHTS = {
    "identify": 12, "check": 22, "simulate": 18, "spectrum": 12, "compare": 7, "design": 6, "study": 4, "validate": 8,
    "draw": 5, "export": 12, "response": 4, "inspect": 6, "new": 3, "fleet": 3,
}  # fmt: skip
# What each command is called with behind its options: a rig, data, or what a tuple offers.
RIGS = ("rig.toml", "forced.toml", "nonlinear.toml", "free.toml")
POSITIONAL: dict[str, tuple[str | tuple[str, ...], ...]] = {
    "identify": ("rig", "data"), "compare": ("rig", "data"), "spectrum": ("rig", "data"), "check": (RIGS,),
    "simulate": (RIGS,), "design": ("rig",), "study": (("study.toml",),), "validate": (("estimate.json",), "data"),
    "draw": (RIGS,), "export": (("estimate.json", "rig.toml", "forced.toml"),), "response": (("nonlinear.toml",),),
    "inspect": ("any",), "new": (("out.toml",),), "fleet": ("rig", "data"),
}  # fmt: skip
# Options without which a command does nothing, would wait for an answer or take more processes.
ALWAYS = {
    "simulate": ("--samples", "16"), "study": ("--processes", "1"), "response": ("--band", "2:6"),
    "fleet": ("--workers", "1"), "new": (
        "--name", "a", "--masses", "2", "--driven-by", "base", "--motion", "displacement", "--unit", "mm",
        "--first-mass", "2",
    ),
}  # fmt: skip
OUTPUTS = {
    "draw": ("out.svg", "out.svg", "out.png", "out.pdf"),
    "export": ("out.json", "out.mat", "out.mtx", "out.xml", "out.csv", "out.m", "out.uff", "out.fmu"),
    "fleet": ("out.parquet",), "response": ("out.csv",),
}  # fmt: skip
PAIRS = (
    ("rig.toml", "amplitudes.csv"), ("rig.toml", "records.csv"), ("rig.toml", "frf.csv"), ("rig.toml", "a.lvm"),
    ("rig.toml", "amplitudes.csv"), ("free.toml", "amplitudes.csv"), ("rig.toml", "xsens.csv"),
    ("rig.toml", "test.toml"), ("rig.toml", "matlab.mat"), ("rig.toml", "uff.uff"), ("rig.toml", "modes.uff"),
    ("forced.toml", "forced.csv"),  # for maximum likelihood, which takes longer
)  # fmt: skip
MOST_COSTLY = {"report", "figure", "drawn_progress", "profiled", "robust", "doubt"}  # rarely drawn


@dataclass(frozen=True)
class Case:
    """One call of the command with the files it finds."""

    arguments: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict)
    what: str = ""

    def to_json(self) -> str:
        """A small file of it; text stays readable."""
        contents: dict[str, str | dict[str, str]] = {}
        for name, content in self.files.items():
            try:
                contents[name] = content.decode("ascii")
            except UnicodeDecodeError:
                contents[name] = {"base64": base64.b64encode(content).decode()}
        return (
            json.dumps({"what": self.what, "arguments": self.arguments, "files": contents}, indent=1) + "\n"
        )

    @staticmethod
    def load(path: Path) -> Case:
        """The case in a file."""
        content = json.loads(path.read_text(encoding="ascii"))
        files = {
            name: text.encode() if isinstance(text, str) else base64.b64decode(text["base64"])
            for name, text in content["files"].items()
        }
        return Case(tuple(content["arguments"]), files, content["what"])

    @property
    def name(self) -> str:
        """A short name that follows from the content."""
        digest = hashlib.sha256(self.to_json().encode()).hexdigest()[:10]
        return f"{self.arguments[0]}-{digest}"


def made(seed: int, index: int) -> Case:
    """The case of that number: it depends on nothing else."""
    rng = random.Random(f"{seed}/{index}")
    return _reading(rng) if rng.random() < READINGS else _command(rng)


def _reading(rng: random.Random) -> Case:
    """A file, or a quantity, that only its reader gets."""
    if rng.random() < 0.1:
        text = mutation.damaged(rng.choice(QUANTITIES).encode(), rng, "txt").decode("utf-8", "replace")
        return Case(("@quantity", rng.choice((text, rng.choice(EXTREMES)))))
    attacking = rng.random() < 0.08
    texts = corpus.attacks() if attacking else corpus.files()
    name = rng.choice(sorted(texts))
    end = name.rpartition(".")[2]
    rig = end == "toml" and b"[[files]]" not in texts[name]
    kind = {"study.toml": "@study", "estimate.json": "@estimate"}.get(name, "@rig" if rig else "@data")
    whole = attacking and rng.random() < 0.5
    files = {name: texts[name] if whole else mutation.damaged(texts[name], rng, end)}
    if kind == "@study":
        files["rig.toml"] = texts["rig.toml"]
    return Case(("@modes" if name.startswith("modes") else kind, name), files)


def _command(rng: random.Random) -> Case:
    """A call of the command."""
    command = rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
    rig, data = rng.choice(PAIRS[:-1] if command in ("identify", "compare") else PAIRS)
    texts = corpus.files()
    words = [_word(kind, rig, data, rng) for kind in POSITIONAL[command]]
    if (command == "check" and rng.random() < 0.4) or (command == "export" and rng.random() < 0.2):
        words.append(data)
    used = set(words) & set(texts)
    if used & {"study.toml", "estimate.json"}:
        used.add("rig.toml")
    if "test.toml" in used:
        used.add("records.csv")
    if command in ("compare", "spectrum") and rng.random() < 0.3:
        used.add("modes.csv" if rng.random() < 0.5 else "modes.json")
    # Most damage is alone, for what is refused at the door hides all that comes behind it.
    where = rng.choice(("options", "file", "file", "file", "both"))
    arguments = _arguments(command, words, rng, used, where != "file")
    files = {name: texts[name] for name in used}
    if where != "options" and files:
        victim = rng.choice(sorted(files))
        files[victim] = mutation.damaged(files[victim], rng, victim.rpartition(".")[2])
    if rng.random() < 0.06:
        old, new = rng.choice(("x1", "x2", "u", "m1", "c1")), rng.choice(mutation.NAMES)
        files = {name: _renamed(content, name, old, new) for name, content in files.items()}
        arguments = [word.replace(old, new) if rng.random() < 0.5 else word for word in arguments]
    return Case(tuple(word.replace("\0", "") for word in arguments), files)


def _word(kind: str | tuple[str, ...], rig: str, data: str, rng: random.Random) -> str:
    """A positional argument."""
    if kind == "any":
        return rng.choice(sorted(corpus.files()))
    return {"rig": rig, "data": data}[kind] if isinstance(kind, str) else rng.choice(kind)


def _renamed(content: bytes, file: str, old: str, new: str) -> bytes:
    """A name changed everywhere, quoted as the format asks."""
    text = content.decode("utf-8", "surrogateescape")
    if file.endswith(".toml"):
        quoted = json.dumps(new)
        text = text.replace(f'"{old}"', quoted).replace(f"{old} =", f"{quoted} =")
    elif file.endswith(".csv"):
        head, _, rest = text.partition("\n")
        cells = [word.replace(old, new).replace('"', '""') for word in head.split(",")]
        text = (
            ",".join(f'"{word}"' if any(c in word for c in ',"\n') else word for word in cells) + "\n" + rest
        )
    return text.encode("utf-8", "surrogatepass" if "\ud800" in text else "surrogateescape")


def _arguments(
    command: str, positional: list[str], rng: random.Random, used: set[str], extreme: bool
) -> list[str]:
    click_command = import_module(f"dashpot.app.commands.{command}").command
    assert isinstance(click_command, click.Command)
    words: list[str] = [command]
    for parameter in click_command.params:
        if not isinstance(parameter, click.Option) or parameter.name in ("help", None):
            continue
        costly = parameter.name in MOST_COSTLY
        if not (parameter.required or rng.random() < (0.01 if costly else 0.12)):
            continue
        option = rng.choice(parameter.opts)
        if parameter.is_flag:
            words.append(option)
            continue
        words += [option, _value(command, parameter, positional, rng, used, extreme)]
    always = ALWAYS.get(command, ())
    for option, value in zip(always[::2], always[1::2], strict=True):
        if option not in words or command in ("study", "fleet"):  # more processes would go past the limits
            words += [option, value]
    words += positional
    if extreme and rng.random() < 0.05:
        words.insert(rng.randrange(1, len(words) + 1), rng.choice(EXTREMES))
    return words


def _value(
    command: str,
    parameter: click.Option,
    positional: list[str],
    rng: random.Random,
    used: set[str],
    extreme: bool,
) -> str:
    kind = parameter.type
    if extreme and rng.random() < 0.4:
        return rng.choice(EXTREMES)
    if isinstance(kind, OutputFile):
        usual = (
            OUTPUTS.get(command, ("out", "out.json", "out.csv"))
            if parameter.required
            else ("out", "out.json")
        )
        usual += tuple(f"out.{each}" for each in kind.formats)
        return rng.choice((*usual * 2, "-", "/dev/null", positional[0] if extreme else usual[0]))
    if isinstance(kind, OutputFolder):
        return "folder"
    if isinstance(kind, click.Choice):
        return str(rng.choice(list(kind.choices)))
    value = rng.choice(SOUND.get(parameter.name or "", ("1", "auto", "0.5")))
    if value in corpus.files() or isinstance(kind, InputFile):
        used.update({value} & set(corpus.files()))
    return value
