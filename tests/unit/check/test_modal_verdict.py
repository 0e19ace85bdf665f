"""The verdict on measured modes: mistakes are named first, clean tests pass as often as χ² says."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.modal import examined_modes
from dashpot.data.modal_data import ModalData
from dashpot.estimate.assessment import Assessment
from dashpot.estimate.modal import identify_modal
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from tests.networks import changed
from tests.unit.estimate.modal.test_identify_modal import chain, measured

Mistake = Callable[[ModalData], ModalData]


def assessed(model: Model, data: ModalData) -> Assessment:
    assessment = examined_modes(model, data, identify_modal(model, data)).assessment
    assert assessment is not None
    return assessment


def clean(seed: int = 5, **known: dict[str, float]) -> tuple[Model, ModalData]:
    rig = chain(None, m1={"value": 2.0}, **known)
    return rig.model, measured(rig, np.random.default_rng(seed))


def turned(data: ModalData) -> ModalData:
    return replace(data, shapes=data.shapes * np.array([1, -1, 1]))


def exchanged(data: ModalData) -> ModalData:
    return replace(data, shapes=data.shapes[:, [1, 0, 2]])


def in_g(data: ModalData) -> ModalData:
    unit = np.array([1, 1, 9.80665])
    return replace(
        data, shapes=data.shapes * unit, shape_covariance=data.shape_covariance * np.outer(unit, unit)
    )


def loss_factors(data: ModalData) -> ModalData:
    return replace(data, damping_ratio=2 * data.damping_ratio)


def angular(data: ModalData) -> ModalData:
    return replace(data, frequency_hz=2 * np.pi * data.frequency_hz)


def of_another_rig(data: ModalData) -> ModalData:
    shapes = np.array(data.shapes)
    shapes[1] = shapes[1, ::-1]
    return replace(data, shapes=shapes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mistake", "kind", "of"),
    [
        pytest.param(turned, "sign", ("x2",), marks=pytest.mark.long),
        pytest.param(exchanged, "swap", ("x1", "x2"), marks=pytest.mark.long),
        (in_g, "unit", ("x3",)),
        pytest.param(of_another_rig, "mode", None, marks=pytest.mark.long),
    ],
)
def test_a_mistake_is_named_first(mistake: Mistake, kind: str, of: tuple[str, ...] | None) -> None:
    model, data = clean()
    wrong = mistake(data)
    assessment = assessed(model, wrong)
    assert assessment.verdict == "does not fit"
    best = assessment.findings[0]
    assert best.kind == kind
    assert best.of == ((f"{wrong.frequency_hz[1]:.4g} Hz",) if of is None else of)
    assert best.remaining is not None
    assert best.remaining < 3


@pytest.mark.long
@pytest.mark.parametrize(("mistake", "kind"), [(loss_factors, "damping"), (angular, "frequency")])
def test_other_units_of_modes_are_named_where_known_parts_show_them(mistake: Mistake, kind: str) -> None:
    model, data = clean(k1={"value": 4000.0}, k2={"value": 2500.0}, c1={"value": 6.0}, c2={"value": 3.0})
    assert assessed(model, mistake(data)).findings[0].kind == kind


@pytest.mark.long
def test_stated_values_that_contradict_each_other_are_both_named() -> None:
    """Modes show ratios: a spring stated too stiff is a mass stated too heavy."""
    model, data = clean(k1={"value": 4000.0})
    stated = changed(model, "k1", value=5200.0)
    findings = {finding.of: finding for finding in assessed(stated, data).findings[:2]}
    assert {finding.kind for finding in findings.values()} == {"value"}
    assert findings["k1",].number == pytest.approx(4000.0, rel=0.05)
    assert findings["m1",].number == pytest.approx(2.0 * 5200 / 4000, rel=0.05)
    assert findings["k1",].elements[0].value is None


@pytest.mark.long
def test_a_missing_spring_is_named_with_the_points_it_joins() -> None:
    rig = chain(None, m1={"value": 2.0})
    spring = between("kg", Kind.SPRING, "x3", "ground", value=1500.0)
    whole = replace(rig, model=replace(rig.model, elements=(*rig.model.elements, spring)))
    data = measured(whole, np.random.default_rng(5))
    best = assessed(rig.model, data).findings[0]
    assert (best.kind, best.of) == ("element", ("x3", "ground"))
    assert best.number == pytest.approx(1500.0, rel=0.1)


@pytest.mark.long
def test_points_that_the_shapes_lack_do_not_keep_a_wrong_sign_from_being_found() -> None:
    rig = chain(None, m1={"value": 2.0}, m2={"value": 1.0}, m3={"value": 3.0}, c1={"value": 6.0})
    data = measured(rig, np.random.default_rng(6), points=("x2", "x3"))
    best = assessed(rig.model, replace(data, shapes=data.shapes * np.array([1, -1]))).findings[0]
    assert (best.kind, best.of[0] in ("x2", "x3")) == ("sign", True)


def test_clean_modes_fit_and_nothing_is_named() -> None:
    """χ² rejects one clean test in a hundred: 3 of 20 come by chance once in 1,000 times (seeds 0 to 19)."""
    verdicts = [assessed(*clean(seed)) for seed in range(20)]
    assert sum(one.verdict != "fits" for one in verdicts) < 3
    fitting = next(one for one in verdicts if one.verdict == "fits")
    assert not fitting.findings
    assert set(fitting.relative_residual) == {"x1", "x2", "x3"}
    assert 0.001 < fitting.relative_residual["x1"] < 0.05
    assert len(fitting.worst) == 3


def test_modes_that_only_just_determine_the_rig_cannot_tell() -> None:
    _, data = clean()
    one = ModalData(
        (),
        data.frequency_hz,
        data.damping_ratio,
        data.covariance,
        data.shapes[:, :0],
        data.shape_covariance[:, :0, :0],
    )
    fixed = chain(None, m1={"value": 2.0}, m2={"value": 1.0}, m3={"value": 3.0}).model
    assessment = assessed(fixed, one)
    assert assessment.verdict == "cannot tell"
    assert "few_degrees" in {reason.code for reason in assessment.reasons}


@pytest.mark.long
def test_two_mistakes_at_once_are_two_causes() -> None:
    model, data = clean()
    findings = assessed(model, in_g(turned(data))).findings
    assert {(each.kind, each.of) for each in findings[:2]} == {("sign", ("x2",)), ("unit", ("x3",))}
    assert [each.beside for each in findings[:2]] == [False, True]
    assert all(each.odds is not None and 0 <= each.odds <= 1 for each in findings)
