"""[blocks] of rig files: every form of file gives the same rig, and what is wrong with one is told at its line."""

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmwrite, savemat

from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.rigfile import read_rig, write_rig

K = np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.5], [0.0, -1.5, 1.5]])


def text(file: str, more: str = "", coordinates: str = "q1:q3") -> str:
    return f"""coordinates = "{coordinates}"

[inputs]
F = {{ kind = "force", at = "q3" }}

[blocks]
k = {{ matrix = "K", file = "{file}"{more} }}
m = {{ matrix = "M", file = "M.npz", value = 2 }}
"""


@pytest.fixture
def folder(tmp_path):
    mmwrite(tmp_path / "K.mtx", sparse.coo_matrix(K), symmetry="symmetric")
    mmwrite(tmp_path / "full.mtx", K)
    sparse.save_npz(tmp_path / "K.npz", sparse.csr_matrix(K))
    np.savez(tmp_path / "M.npz", M=np.eye(3))
    np.savez(tmp_path / "both.npz", K=K, other=np.eye(3))
    savemat(tmp_path / "K.mat", {"K": sparse.csc_matrix(K)})
    savemat(tmp_path / "both.mat", {"K": K, "other": np.eye(3)})
    np.savetxt(tmp_path / "K.csv", K, delimiter=",")
    (tmp_path / "semicolons.csv").write_text("\n".join(";".join(map(repr, row)) for row in K.tolist()))
    (tmp_path / "words.csv").write_text("q1,q2,q3\n1,2,3\n")
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    (tmp_path / "broken.mtx").write_text("no matrix\n")
    (tmp_path / "broken.npz").write_text("no arrays\n")
    return tmp_path


@pytest.mark.parametrize(
    ("file", "more"),
    [
        ("K.mtx", ""),
        ("full.mtx", ""),
        ("K.npz", ""),
        ("both.npz", ', array = "K"'),
        ("K.mat", ""),
        ("both.mat", ', array = "K"'),
        ("K.csv", ""),
        ("semicolons.csv", ""),
    ],
)
def test_every_form_of_file_gives_the_same_rig(folder, file, more):
    (folder / "rig.toml").write_text(text(file, more))
    model = read_rig(folder / "rig.toml").model
    assert model.coordinates == ("q1", "q2", "q3")
    assert [(u.name, u.guess, u.unit) for u in model.unknowns] == [("k", 1.0, "1")]
    parts = matrices(model, model.parameters(np.array([0.9])))
    np.testing.assert_allclose(parts.K, 0.9 * K, rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(parts.M, 2 * np.eye(3))
    with pytest.raises(ModelError, match="blocks"):
        write_rig(read_rig(folder / "rig.toml"))


def test_rows_may_be_named(folder):
    more = ', coordinates = ["q3", "q2", "q1"], sd = 0.1, value = 1'
    (folder / "rig.toml").write_text(text("K.mtx", more))
    model = read_rig(folder / "rig.toml").model
    np.testing.assert_allclose(matrices(model, model.parameters(np.ones(1))).K, K[::-1, ::-1], rtol=1e-14)
    assert model.unknowns[0].sd == 0.1


@pytest.mark.parametrize(
    ("file", "more", "cause"),
    [
        ("none.mtx", "", "rig.toml:7: blocks.k.file: none.mtx cannot be read"),
        ("broken.mtx", "", "blocks.k.file: broken.mtx cannot be read"),
        ("broken.npz", "", "blocks.k.file: broken.npz cannot be read"),
        ("both.npz", "", "blocks.k.file: both.npz holds several arrays; say array = one of K, other"),
        ("broken.mat", "", "blocks.k.file: broken.mat cannot be read"),
        ("both.mat", "", "blocks.k.file: both.mat holds several arrays; say array = one of K, other"),
        ("words.csv", "", "blocks.k.file: words.csv cannot be read"),
        ("K.xyz", "", "blocks.k.file: K.xyz has no known"),
        ("K.mtx", ', coordinates = ["q1", "q2"]', "the matrix of k"),
        ("K.mtx", ', coordinates = ["q1", "q2", "q9"]', 'blocks.k.coordinates: "q9"'),
        ("K.mtx", ', coordinates = ["q1", "q2", "q2"]', "appears twice"),
        ("K.mtx", ', unit = "N/m"', "blocks.k.unit: unknown key"),
    ],
)
def test_what_is_wrong_is_told_at_its_line(folder, file, more, cause):
    (folder / "rig.toml").write_text(text(file, more))
    with pytest.raises(ModelError) as caught:
        read_rig(folder / "rig.toml")
    assert cause in str(caught.value)


@pytest.mark.parametrize("wrong", ["q3:q1", "q1:x3", "q1:q9999999", "q1-q3"])
def test_what_is_no_range_of_coordinates(folder, wrong):
    (folder / "rig.toml").write_text(text("K.mtx", coordinates=wrong))
    with pytest.raises(ModelError, match=r"rig\.toml:1: coordinates"):
        read_rig(folder / "rig.toml")
