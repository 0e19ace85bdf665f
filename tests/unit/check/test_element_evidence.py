"""Nonlinear elements ranked by evidence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.element_evidence import _Scored, compare_in_records, with_nothing
from dashpot.data.record import Record
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.model.elements import Kind, between
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.force_law import force_law
from dashpot.study.simulate import driven_record
from tests.networks import network
from tests.nonlinear_rigs import motions

TRUTH = np.array([1.0, 900.0, 2.0, 4e6])


def rig(*laws):
    joints = [
        replace(between(f"k{i}", Kind.SPRING, "x", "u"), force_law=force_law(law))
        for i, law in enumerate(laws)
    ]
    return network("x", "u", "m@x=1 k:x-u c:x-u", *joints)


def record(model, theta):
    rng = np.random.default_rng(4)
    time = np.arange(500) / 100
    u = 2e-4 * np.sum(
        np.cos(2 * np.pi * rng.uniform(1, 12, 20) * time[:, None] + rng.uniform(0, 6, 20)), axis=1
    )
    channels = (replace(motions("x")[0], noise=5e-5), *motions("u"))
    return driven_record(model, theta, channels, Record((channels[1],), time, u[:, None]), rng)


@pytest.mark.long
def test_the_law_that_made_the_record_has_the_most_evidence_and_one_that_is_there_none_beside_it():
    whole = rig("cubic")
    data = record(whole, TRUTH[1:])
    found = compare_in_records(rig(), [data])
    assert found.chosen.elements[0].force_law.text == "cubic"
    assert found.ranked[0].evidence > found.ranked[1].evidence
    content = json.loads(found.to_json())
    assert content["called_for"]["elements"][0]["section"] == "springs"
    assert fit_records(whole, [data]).estimate().converged
    again = compare_in_records(whole, [data])
    assert again.chosen is None or again.chosen.evidence < 0.02 * found.chosen.evidence


def test_sets_of_candidates_are_tried_by_what_they_explain_together():
    """Two of six candidates carry the signal but nearly cancel, so that others explain more alone."""
    rng = np.random.default_rng(2)
    J = rng.standard_normal((400, 8))  # two unknowns of the rig, six candidates
    J[:, 3] = -J[:, 2] + 0.1 * J[:, 3]
    residual = 5 * (J[:, 2] + J[:, 3]) + 0.2 * J[:, 5] + 0.01 * rng.standard_normal(400)
    gram, right = J.T @ J, J.T @ residual
    scale = np.sqrt(np.diag(gram))
    scored = _Scored(gram / np.outer(scale, scale), right / scale, scale, (0, 1), (2, 3, 4, 5, 6, 7))
    trials = scored.trials()
    assert len(set(trials)) == len(trials)
    assert max(trials, key=scored.fall) == (0, 1, 3)
    assert (0, 1) in trials
    left = residual - J[:, [0, 1, 2, 3]] @ np.linalg.lstsq(J[:, [0, 1, 2, 3]], residual, rcond=None)[0]
    assert scored.fall((0, 1)) == pytest.approx(residual @ residual - left @ left, rel=1e-9)
    assert np.allclose(scored.values((0, 1, 3)), [5, 5, 0.2], atol=0.1)


def test_a_test_stand_without_its_law_is_followed_as_well() -> None:
    """A rig without coordinates: the idle element lies between its input and the ground (it was an internal error)."""
    stand = Model((), (Input("u"),), (between("k", Kind.SPRING, "u", "ground"),))
    assert set(with_nothing(stand).elements[-1].along) == {"u"}
