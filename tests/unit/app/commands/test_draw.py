"""dashpot draw."""

from pathlib import Path

from tests.unit.app.conftest import Command


def test_it_draws_the_rig_its_estimate_and_its_modes(dashpot: Command, data: Path) -> None:
    assert dashpot("identify", "rig.toml", "data.csv", "--json", "e.json", "-q").code == 0
    for name, options in {
        "rig": (),
        "values": ("--estimate", "e.json"),
        "mode": ("--estimate", "e.json", "--mode", "1"),
    }.items():
        done = dashpot("draw", "rig.toml", "-o", f"{name}.svg", *options)
        assert (done.code, done.out, done.err) == (0, "", [])
    assert "m1 = ?" in Path("rig.svg").read_text(encoding="utf-8")
    assert "95 % interval" in Path("values.svg").read_text(encoding="utf-8")
    assert "<animate " in Path("mode.svg").read_text(encoding="utf-8")


def test_what_cannot_be_drawn_takes_one_line(dashpot: Command, data: Path) -> None:
    for words in (
        ("draw", "rig.toml", "-o", "rig.jpg"),
        ("draw", "rig.toml", "-o", "rig.toml"),
        ("draw", "rig.toml", "-o", "rig.svg", "--mode", "1"),
        ("draw", "rig.toml", "-o", "rig.svg", "--estimate", "data.csv"),
    ):
        done = dashpot(*words)
        assert done.code == 2
        assert len(done.err) == 1
    assert not Path("rig.svg").exists()
