"""Universal files against pyuff, both ways, in all number types and byte orders; and what is damaged."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.uff import (
    FRF,
    TIME_RESPONSE,
    NodalFunction,
    NodalMode,
    NodePoint,
    from_ibm,
    from_vax,
    functions_of,
    modes_of,
)
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DashpotError, DataError
from tests.unit.data.readers.written import CHANNELS, packed

pyuff = pytest.importorskip("pyuff")
# pyuff opens files without closing them.
pytestmark = pytest.mark.filterwarnings("ignore")


def functions(even=True, seed=1, count=37):
    """A response over time and an FRF, of numbers with all their digits."""
    rng = np.random.default_rng(seed)
    t = 0.5 + np.arange(count) / 3 if even else np.sort(rng.uniform(0, 1, count))
    H = rng.normal(size=count) + 1j * rng.normal(size=count)
    return [
        NodalFunction(
            TIME_RESPONSE,
            NodePoint("", 3, 3),
            NodePoint(),
            t,
            rng.normal(size=count),
            "m",
            ids=("one",),
            even=even,
        ),
        NodalFunction(
            FRF, NodePoint("", 3, -1), NodePoint("", 1, 3), t, H, "m/s2", "N", ids=("two",), even=even
        ),
    ]


def same(got, wanted, rel, rel_abscissa=None):
    assert (got.kind, got.response, got.reference) == (wanted.kind, wanted.response, wanted.reference)
    assert (got.unit, got.reference_unit) == (wanted.unit, wanted.reference_unit)
    assert got.abscissa == pytest.approx(wanted.abscissa, rel=rel if rel_abscissa is None else rel_abscissa)
    assert got.ordinate == pytest.approx(wanted.ordinate, rel=rel, abs=0)


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("binary", [True, False])
def test_what_is_written_reads_back_and_pyuff_reads_it(tmp_path, binary, double, even, little):
    path, wanted = tmp_path / "a.uff", functions(even)
    write_universal_file(path, wanted, binary=binary, double=double, little=little)
    rel = 0 if binary and double else 6e-8 if binary else 1e-12 if double else 5e-6
    for got, expected in zip(functions_of(open_file(path)), wanted, strict=True):
        same(got, expected, rel, 1e-15 if even else 5e-6 if not binary else rel)
    for got, expected in zip(pyuff.UFF(str(path)).read_sets(), wanted, strict=True):
        assert got["data"] == pytest.approx(expected.ordinate, rel=max(rel, 1e-15))
        assert got["x"] == pytest.approx(expected.abscissa, rel=5e-6)
        assert (got["func_type"], got["rsp_node"], got["rsp_dir"]) == (
            expected.kind,
            expected.response.node,
            expected.response.direction,
        )
        assert got["ordinate_axis_units_lab"].strip() == expected.unit


@pytest.mark.parametrize("even", [1, 0])
@pytest.mark.parametrize(("binary", "double"), [(1, True), (0, True), (0, False)])
def test_what_pyuff_writes_is_read(tmp_path, binary, double, even):
    path, wanted = tmp_path / "a.uff", functions()
    file = pyuff.UFF(str(path))
    for function in wanted:
        is_complex = np.iscomplexobj(function.ordinate)
        file.write_sets(
            pyuff.prepare_58(
                binary=binary, func_type=function.kind, rsp_node=function.response.node,
                rsp_dir=function.response.direction, ref_node=function.reference.node,
                ref_dir=function.reference.direction, ordinate_axis_units_lab=function.unit,
                orddenom_axis_units_lab=function.reference_unit, orddenom_spec_data_type=0,
                ord_data_type=(6 if double else 5) if is_complex else (4 if double else 2),
                data=function.ordinate, x=function.abscissa, abscissa_spacing=even, id1=function.ids[0],
            ),
            mode="add", force_double=double,
        )  # fmt: skip
    rel = (0 if double else 6e-8) if binary else (1e-11 if double else 1e-5)
    for got, expected in zip(functions_of(open_file(path)), wanted, strict=True):
        same(got, expected, rel, 1e-5)


def test_frequency_responses_are_named_by_nodes_or_entities(tmp_path):
    rng = np.random.default_rng(3)
    f, H = np.arange(1, 6.0), rng.normal(size=(2, 5)) + 1j * rng.normal(size=(2, 5))
    channels = (
        Channel("x1", {"x1": 1}, Quantity.ACCELERATION),
        Channel("x2", {"x2": 1}, Quantity.ACCELERATION),
        Channel("F", {"F": 1}, Quantity.FORCE),
    )
    named = [NodalFunction(FRF, NodePoint(f"x{i + 1}"), NodePoint("F"), f, H[i]) for i in range(2)]
    write_universal_file(tmp_path / "named.uff", named)
    lines = read(tmp_path / "named.uff", channels).spectrum()
    assert lines.amplitudes[:, 0] == pytest.approx(H[0])
    assert lines.amplitudes[:, 1] == pytest.approx(H[1])
    assert lines.amplitudes[:, 2] == pytest.approx(np.ones(5))
    numbered = [NodalFunction(FRF, NodePoint("", i + 1, 3), NodePoint("", 1, -3), f, H[i]) for i in range(2)]
    write_universal_file(tmp_path / "numbered.uff", numbered)
    (tmp_path / "test.toml").write_text(
        '[[files]]\nname = "numbered.uff"\ncolumns = { x1 = "1+Z", x2 = "2+Z", F = "1-Z" }\n'
    )
    assert np.array_equal(read(tmp_path / "test.toml", channels).spectrum().amplitudes, lines.amplitudes)


def test_numbers_of_old_machines():
    # Figures of the manuals: IBM System/370 118.625 is C276A000 negated; VAX F_floating 1.0 is 0x00004080 in words.
    assert from_ibm(np.array([0xC276A000], dtype=np.uint32), 4)[0] == -118.625
    assert from_ibm(np.array([0x4110000000000000], dtype=np.uint64), 8)[0] == 1.0
    assert from_vax(np.frombuffer(b"\x80\x40\x00\x00", dtype="<u2"), 4)[0] == 1.0
    assert from_vax(np.frombuffer(b"\x00\xc1" + b"\x00" * 6, dtype="<u2"), 8)[0] == -2.0
    assert from_vax(np.zeros(2, dtype="<u2"), 4)[0] == 0.0


def test_modes_both_ways(tmp_path):
    rng = np.random.default_rng(4)
    shapes = np.round(rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3)), 3)
    modes = [
        NodalMode(complex(-0.5, 12.5), (1, 7), shapes, ("first",)),
        NodalMode(-1 + 30j, (1, 7), 2 * shapes),
    ]
    path = tmp_path / "modes.unv"
    write_universal_file(path, modes=modes)
    for got, wanted in zip(modes_of(open_file(path)), modes, strict=True):
        assert got.eigenvalue == pytest.approx(wanted.eigenvalue, rel=1e-5)
        assert got.nodes == wanted.nodes
        assert got.shapes == pytest.approx(wanted.shapes, rel=1e-5)
    sets = pyuff.UFF(str(path)).read_sets()
    assert [s["eig"] for s in sets] == pytest.approx([m.eigenvalue for m in modes], rel=1e-5)
    assert sets[0]["r3"] == pytest.approx(shapes[:, 2], rel=1e-5)


ONE, TWO = np.array([1.0, 2.0]), np.array([1 + 0.5j, 2 - 0.3j])
MODES_OF_PYUFF = {
    "real": ({"analysis_type": 2, "data_type": 2, "r1": ONE, "r2": 0 * ONE, "r3": -ONE}, 3),
    "real, with rotations": (
        {"analysis_type": 2, "data_type": 2, "data_ch": 3, **{f"r{k}": k * ONE for k in range(1, 7)}}, 6,
    ),
    "complex, by displacement": ({"analysis_type": 3, "data_type": 5, "r1": TWO, "r2": -TWO, "r3": 1j * TWO}, 3),
    "complex, by velocity": ({"analysis_type": 7, "data_type": 5, "r1": TWO, "r2": -TWO, "r3": 1j * TWO}, 3),
}  # fmt: skip


@pytest.mark.parametrize("ending", [".unv", ".unv.gz"])
@pytest.mark.parametrize("kind", MODES_OF_PYUFF)
def test_modes_of_all_kinds_that_pyuff_writes_are_read(tmp_path, kind, ending):
    content, directions = MODES_OF_PYUFF[kind]
    real = content["analysis_type"] == 2
    damped = {"freq": 2.5, "modal_m": 1.0, "modal_damp_vis": 0.02, "modal_damp_his": 0.0}
    eigen = {"eig": -1 + 20j, "modal_a": 1 + 0j, "modal_b": 1 + 0j}
    fields = {
        "model_type": 1, "data_ch": 2, "spec_data_type": 8, "load_case": 0, "mode_n": 1,
        "node_nums": np.array([1, 2]), **(damped if real else eigen), **content,
    }  # fmt: skip
    path = tmp_path / "theirs.unv"
    pyuff.UFF(str(path)).write_sets(pyuff.prepare_55(**fields), mode="add")
    if ending.endswith(".gz"):
        path = packed(path)
    (mode,) = modes_of(open_file(path))
    w = 2 * np.pi * 2.5
    expected = complex(-0.02 * w, w * np.sqrt(1 - 0.02**2)) if real else -1 + 20j
    assert mode.eigenvalue == pytest.approx(expected, rel=1e-5)
    assert mode.shapes == pytest.approx(np.stack([content[f"r{k + 1}"] for k in range(directions)], -1))


@pytest.mark.parametrize("binary", [True, False])
def test_damaged_files(tmp_path, binary):
    whole, path = tmp_path / "whole.uff", tmp_path / "cut.uff"
    write_universal_file(whole, functions(), binary=binary)
    data = whole.read_bytes()
    got = list(functions_of(open_file(whole)))
    ends = [i + 7 for i in range(len(data)) if data[i : i + 7] == b"    -1\n"]
    for length in range(1, len(data), 13):
        path.write_bytes(data[:length])
        try:
            part = list(functions_of(open_file(path)))
        except DashpotError as error:
            said = str(error)
        else:
            said = ""
            complete = max(end for end in [0, *ends] if end <= length + 1)
            assert not data[complete:length].strip()
            assert all(np.array_equal(a.ordinate, b.ordinate) for a, b in zip(part, got, strict=False))
        assert "\n" not in said
    for lie, what in (
        (b"        37", b"        36"),
        (b"        37", b"        38"),
        (b"        37", b"999999999 "),
    ):
        path.write_bytes(data.replace(lie, what, 1))
        with pytest.raises(DataError, match=r"cut.uff"):
            list(functions_of(open_file(path)))


def test_other_datasets_are_passed_over(tmp_path):
    path = tmp_path / "a.uff"
    write_universal_file(path, functions())
    other = b"    -1\n   151\n" + b"text\n" * 7 + b"    -1\n    -1\n   164\n  1SI\n    -1\n"
    path.write_bytes(other + path.read_bytes())
    assert len(list(functions_of(open_file(path)))) == 2
    path.write_bytes(other)
    with pytest.raises(DataError, match="holds no samples"):
        read(path, CHANNELS)
    path.write_bytes(other + other.replace(b"   151", b"    55"))
    with pytest.raises(DataError, match=r"but modes \(dataset 55\)"):
        read(path, CHANNELS)
