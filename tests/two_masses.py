"""Files that many tests share: two masses on a shaken base, a study of it, a rig whose springs are alike."""

from dashpot.model.network import Model
from dashpot.model.rigfile import Rig, parse_rig
from tests.networks import network

RIG = """\
name = "Two masses on a shaken base"
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacement" }
[masses]
m1 = { at = "x1" }
m2 = { at = "x2", value = 2.7 }
[springs]
k1 = { between = ["x1", "x2"], value = 4600 }
k2 = { between = ["x2", "u"], value = 4600 }
[dampers]
c1 = { between = ["x1", "x2"] }
c2 = { between = ["x2", "u"] }
[channels]
x1 = { of = "x1", unit = "mm", noise = 0.02 }
x2 = { of = "x2", unit = "mm", noise = 0.02 }
u = { of = "u", unit = "mm" }
"""
# The same with nothing known, its channels to follow.
OPEN = """\
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacement" }
[masses]
m1 = { at = "x1" }
m2 = { at = "x2" }
[springs]
k1 = { between = ["x1", "x2"] }
k2 = { between = ["x2", "u"] }
[dampers]
c1 = { between = ["x1", "x2"] }
c2 = { between = ["x2", "u"] }
"""
# Two masses held by the ground, one of them known, the rest guessed; inputs and channels to be added.
HELD = """\
[masses]
m1 = { at = "x1", value = 2 }
m2 = { at = "x2", guess = 1 }
[springs]
k1 = { between = ["x1", "ground"], guess = 8000 }
k2 = { between = ["x1", "x2"], guess = 3000 }
[dampers]
c1 = { between = ["x1", "ground"], guess = 8 }
c2 = { between = ["x1", "x2"], guess = 3 }
"""
VALUES = {"m1": 3.0, "c1": 20.0, "c2": 30.0}
TWO_SCENARIOS = """\
name = "noise"
seed = 5
[rigs.two]
file = "rig.toml"
values = { m1 = 3.0, c1 = 20.0, c2 = 30.0 }
[frequencies]
few = [2, 4, 6, 8, 10, 12]
[[grid]]
methods = ["wls", "oiv"]
noise = [0.01, 0.1]
samples = 20
draws = 4
"""
UNDETERMINED = """\
coordinates = ["x"]
[inputs]
u = {}
[masses]
m = { at = "x", value = 1.0 }
[springs]
k1 = { between = ["x", "ground"] }
k2 = { between = ["x", "ground"] }
k3 = { between = ["x", "u"] }
[channels]
x = { of = "x" }
u = { of = "u" }
"""
PUSHED = {"m1": 2.0, "m2": 1.0, "k1": 4000.0, "k2": 2500.0, "c1": 12.0, "c2": 5.0}
HEAD = 'coordinates = ["x1", "x2"]\n[inputs]\nu = {}\n'
SEEN = '[channels]\nx1 = { of = "x1" }\nx2 = { of = "x2" }\nu = { of = "u" }\n'


SHAKEN = network("x1 x2", "u", "m1@x1 m2@x2=2.7 k1:x1-x2 k2:x2-u=4600 c1:x1-x2 c2:x2-u")
SHAKEN_TRUTH = {"m1": 3.0, "k1": 4600.0, "c1": 5.0, "c2": 8.0}


def two_mass_rig(
    more: str = "", k1: str = ", value = 4600", seen: str = SEEN, dampers: str = "", head: str = HEAD
) -> Rig:
    """Two masses on a shaken base with a damper to ground, and what a test adds or changes."""
    text = (
        f'{head}[masses]\nm1 = {{ at = "x1" }}\nm2 = {{ at = "x2" }}\n'
        f'[springs]\nk1 = {{ between = ["x1", "x2"]{k1} }}\nk2 = {{ between = ["x2", "u"] }}\n{more}'
        f'[dampers]\nc2 = {{ between = ["x2", "u"] }}\nc4 = {{ between = ["x2", "ground"] }}\n{dampers}{seen}'
    )
    return parse_rig(text)


def pushed_pair(base: str) -> Model:
    """Two masses in a row on `base`, "u" or "ground", with a force on the first; true values are PUSHED."""
    inputs = "u f@x1" if base == "u" else "f@x1"
    return network("x1 x2", inputs, f"m1@x1 m2@x2 k1:x1-{base} k2:x1-x2 c1:x1-{base} c2:x1-x2")


def one_mass(
    drive: str = "", m: str = "", k: str = "", c: str = "", of: dict[str, str] | None = None, **springs: str
) -> str:
    """The file of a mass x on a spring and a damper: pushed by "f", on a base "u" that moves, or let go.

    What each entry says beside its place: of the parts, of more springs by their names, of the channels in `of`, which
    are x and the drive where nothing is said, and none where it is empty.
    """
    at, ends = 'at = "x"', 'between = ["x", "u"]' if drive == "u" else 'between = ["x", "ground"]'
    inputs = {"f": {"f": 'kind = "force", at = "x"'}, "u": {"u": 'kind = "displacement"'}, "": {}}[drive]
    sections: dict[str, dict[str, str]] = {
        "inputs": inputs,
        "masses": {"m": f"{at}, {m}"},
        "springs": {name: f"{ends}, {more}" for name, more in {"k": k, **springs}.items()},
        "dampers": {"c": f"{ends}, {c}"},
        "channels": {
            name: more if more.startswith("of =") else f'of = "{name}", {more}'
            for name, more in ({"x": "", **dict.fromkeys(inputs, "")} if of is None else of).items()
        },
    }
    text = 'coordinates = ["x"]\n'
    for section, entries in sections.items():
        if entries:
            text += f"[{section}]\n" + "".join(f"{n} = {{ {e.rstrip(', ')} }}\n" for n, e in entries.items())
    return text
