"""The same bits whoever computes what when; what lies in a folder is used as far as it belongs to the study."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.study import montecarlo
from dashpot.study.blocks import BlockStore
from dashpot.study.montecarlo import Repeats, rehearse, run_study, summarise
from dashpot.study.scenario import ScenarioGrid, Study, TrueRig, scenarios, share_out, with_unknowns
from dashpot.study.simulate import standard_channels
from tests.networks import network

MOTION = (Quantity.DISPLACEMENT, Quantity.VELOCITY)


def one_mass():
    model = network("x", "u", "m@x c:x-u c0:x-ground k:x-u=4600")
    return TrueRig(model, {"m": 3.0, "c": 30.0, "c0": 50.0}, standard_channels(model, MOTION))


@pytest.fixture
def study():
    grid = ScenarioGrid(("one",), ("few",), (0.02, 0.1), (16,), ("ls", "iv", "oiv"), 50)
    return Study(
        "small", 7, {"one": one_mass()}, {"few": (2.0, 5.0, 8.0), "many": tuple(range(1, 13))}, (grid,)
    )


def bits(results):
    """All repeats as bytes."""
    found = []
    for one in results.scenarios:
        for name, own in results.repeats(one).items():
            arrays = (own.values, own.sd, own.half, own.converged, own.p)
            found.append((one.name, name, *(array.tobytes() for array in arrays)))
    return found


def backwards(function, work):
    """A map that does the last first."""
    return [function(task) for task in reversed(list(work))]


def test_any_order_gives_the_same_bits(study):
    """As two processes do (tests/unit/app/commands/test_study.py)."""
    points = scenarios(study)
    plain = montecarlo.run_scenarios(points, 7, block=20)
    assert bits(montecarlo.run_scenarios(points, 7, block=20, mapper=backwards)) == bits(plain)
    assert bits(montecarlo.run_scenarios(points, 8, block=20)) != bits(plain)


def test_scenarios_do_not_depend_on_their_neighbours(study):
    """The draws of a point follow from its own name: alone, or in another order, it has the same."""
    points = scenarios(study)
    alone = montecarlo.run_scenarios(points[1:], 7, block=20)
    assert bits(alone)[0] == bits(montecarlo.run_scenarios(points, 7, block=20))[3]
    first, second = (own["oiv"].values for own in map(montecarlo.run_scenarios(points, 7).repeats, points))
    assert abs(np.corrcoef(first[:, 0], second[:, 0])[0, 1]) < 0.5


def test_blocks_are_different_draws(study):
    one = scenarios(study)[0]
    values = montecarlo.run_scenarios([one], 7, block=10).repeats(one)["oiv"].values
    assert len(np.unique(values[:, 0])) == 50


def test_an_interrupted_study_goes_on_with_the_same_result(study, tmp_path):
    whole = run_study(study, tmp_path / "whole", block=20)
    count = 0

    def interrupted(function, work):
        nonlocal count
        for task in work:
            if count == 4:
                raise KeyboardInterrupt
            count += 1
            yield function(task)

    with pytest.raises(KeyboardInterrupt):
        run_study(study, tmp_path / "cut", block=20, mapper=interrupted)
    blocks = sorted((tmp_path / "cut").rglob("*.parquet"))
    assert len(blocks) == 4
    assert not (tmp_path / "cut" / "summary.parquet").exists()
    blocks[0].write_bytes(blocks[0].read_bytes()[:-100])  # and one is damaged
    seen = []
    again = run_study(
        study, tmp_path / "cut", block=20, progress=lambda done, total: seen.append((done, total))
    )
    assert again.columns() == whole.columns()
    # Four blocks of 20, one of them the last of its scenario with 10 draws, are there; the damaged one is not counted.
    assert seen[0][1] == 2 * 50 * 3
    assert 0 < seen[0][0] < seen[-1][0] == 2 * 50 * 3
    one, other = (tmp_path / name / "summary.parquet" for name in ("whole", "cut"))
    assert one.read_bytes() == other.read_bytes()
    assert not list(tmp_path.rglob(".*"))  # nothing temporary is left


def test_without_a_folder_the_result_is_the_same(study, tmp_path):
    assert run_study(study, block=20).columns() == run_study(study, tmp_path / "s", block=20).columns()


@pytest.mark.slow
def test_a_study_grows_on_what_it_has(study, tmp_path):
    run_study(study, tmp_path / "s", block=20)
    more = replace(study, grids=(replace(study.grids[0], draws=100, noise=(0.02, 0.1, 0.2)),))
    fresh = run_study(more, block=20)
    computed = []

    def counting(function, work):
        work = list(work)
        computed.extend(work)
        return map(function, work)

    assert run_study(more, tmp_path / "s", block=20, mapper=counting).columns() == fresh.columns()
    # Of each old point three blocks more (the last of the old ones was short), of the new one all five.
    assert len(computed) == 3 + 3 + 5


@pytest.mark.slow
def test_blocks_that_share_a_file_are_the_same_draws(study, tmp_path, monkeypatch):
    """Twelve blocks, the first two in files of their own, then four to a file: in one go, and grown from seven."""
    more = replace(study, grids=(replace(study.grids[0], draws=116, noise=(0.1,)),))
    alone = bits(montecarlo.run_scenarios(scenarios(more), 7, block=10))
    monkeypatch.setattr(montecarlo, "ALONE", 2)
    monkeypatch.setattr(montecarlo, "TOGETHER", 4)
    assert bits(montecarlo.run_scenarios(scenarios(more), 7, block=10)) == alone
    few = replace(more, grids=(replace(more.grids[0], draws=65),))
    run_study(few, tmp_path / "s", block=10)
    grown = run_study(more, tmp_path / "s", block=10)
    assert grown.columns() == run_study(more, tmp_path / "whole", block=10).columns()
    names = ["000000", "000001", "000002", "000006", "000010"]
    assert [path.stem for path in sorted((tmp_path / "s" / "draws").rglob("*.parquet"))] == names
    results = montecarlo.run_scenarios(scenarios(more), 7, block=10, store=BlockStore(tmp_path / "s"))
    assert bits(results) == alone


def test_a_folder_of_another_format_is_refused(study, tmp_path):
    run_study(study, tmp_path / "s", block=25)
    manifest = tmp_path / "s" / "study.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"format": 2}))
    with pytest.raises(UsageError, match="holds a study"):
        run_study(study, tmp_path / "s", block=25)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 8}, "a study with seed"),
        ({"periods": 2.0}, "holds another study: rig=one"),
        ({"drift": 1}, "holds another study: rig=one"),
    ],
)
def test_another_study_is_not_mixed_in(study, tmp_path, change, message):
    run_study(study, tmp_path / "s", block=25)
    with pytest.raises(UsageError, match=message):
        run_study(replace(study, **change), tmp_path / "s", block=25)


def test_folders_that_are_no_study_are_left_alone(study, tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(UsageError, match="other files"):
        run_study(study, tmp_path)
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "study.json").write_text(json.dumps({"format": 1}))
    with pytest.raises(UsageError, match="not a study"):
        run_study(study, tmp_path / "s")
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot be used"):
        run_study(study, tmp_path / "file")


def test_summary_of_known_numbers():
    """Normal errors of known mean and sd: every figure within 5 of the standard errors that it states."""
    rng = np.random.default_rng(3)
    theta = np.array([2.0, -5.0])
    sd, bias, count = np.array([0.1, 0.05]), np.array([0.02, 0.0]), 20_000
    values = theta + bias + sd * rng.standard_normal((count, 2))
    converged = np.ones(count, dtype=bool)
    converged[:100] = False
    values[50:150] = np.nan
    half = np.broadcast_to(1.96 * sd, values.shape)
    repeats = Repeats(values, half / 1.96, half, converged, rng.uniform(size=count))
    s = summarise(repeats, theta, 0.8 * sd)
    size = np.abs(theta) / 100
    assert s.failed == 150
    assert np.all(np.abs(s.mean - bias / size) < 5 * s.mean_se)
    assert np.all(np.abs(s.spread - sd / size) < 5 * s.spread_se)
    assert np.allclose(s.spread_se, sd / size / np.sqrt(2 * count), rtol=0.05)
    assert np.allclose(s.efficiency, 0.64, rtol=0.05)
    assert abs(s.coverage[1] - 95) < 5 * s.coverage_se[1]
    assert s.coverage[0] < 95
    assert s.quantiles[2] == pytest.approx(bias / size, abs=0.2)
    assert s.rejected == pytest.approx(5.0, abs=0.8)
    nothing = summarise(replace(repeats, converged=np.zeros(count, dtype=bool)), theta, sd)
    assert nothing.failed == count
    assert np.all(np.isnan(nothing.spread))


def test_two_grids_share_a_point(study):
    base = study.grids[0]
    both = replace(study, grids=(base, replace(base, noise=(0.1,), methods=("oiv", "wls"), draws=80)))
    points = scenarios(both)
    assert len(points) == 2
    assert points[1].methods == ("ls", "iv", "oiv", "wls")
    assert points[1].draws == 80


def test_unknowns_can_be_known_and_known_ones_unknown():
    bench = one_mass()
    model = with_unknowns(bench, ("m", "k"))
    assert [unknown.name for unknown in model.unknowns] == ["m", "k"]
    assert model.p0.tolist() == [0, 30, 50, 0]
    with pytest.raises(UsageError, match="q is not a parameter"):
        with_unknowns(bench, ("q",))


def test_samples_in_all_are_shared_out():
    assert share_out(11, 4).tolist() == [3, 3, 3, 2]
    with pytest.raises(UsageError, match="use 8 or more"):
        share_out(7, 4)


def test_what_cannot_work_fails_at_once(study):
    free = replace(study.rigs["one"], values=dict(study.rigs["one"].values) | {"k": 4600.0})
    all_unknown = replace(study, rigs={"one": free}, unknowns={"every": ("m", "c", "c0", "k")})
    with pytest.raises((IdentifiabilityError, UsageError), match="rig=one"):
        rehearse(scenarios(replace(all_unknown, grids=(replace(study.grids[0], unknowns=("every",)),))))
    blind = replace(
        study.rigs["one"], channels=study.rigs["one"].channels[:1] + study.rigs["one"].channels[2:]
    )
    with pytest.raises(DashpotError, match="rig=one"):  # ls reads dampers from velocities, and there are none
        rehearse(scenarios(replace(study, rigs={"one": blind})))


def test_noise_of_the_rigs_own_channels(study):
    bench = study.rigs["one"]
    grid = replace(study.grids[0], kind="channels", noise=(2.0,))
    with pytest.raises(UsageError, match="no channel of the rig"):
        scenarios(replace(study, grids=(grid,)))
    noisy = tuple(replace(channel, noise=0.1) for channel in bench.channels)
    (point,) = scenarios(replace(study, rigs={"one": replace(bench, channels=noisy)}, grids=(grid,)))
    assert {channel.noise for channel in point.channels} == {0.2}
