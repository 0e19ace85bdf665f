"""One value says how records become amplitudes; its fields serve as keywords."""

import dataclasses

import pytest

from dashpot.data.conditioning.settings import Conditioning, FitTreatments, Treatments, conditioning_of
from dashpot.errors import DataError


def test_words_and_values_mean_the_same():
    assert Conditioning(harmonics=None) == Conditioning(harmonics="auto") == Conditioning()
    assert Conditioning(harmonics="none") == Conditioning(harmonics=())
    assert Conditioning(drift=None) == Conditioning(drift="none")
    assert Conditioning(refine=True, settle=True) == Conditioning(refine="always", settle="auto")
    assert Conditioning(refine=False, settle=False) == Conditioning(refine="none")
    assert Conditioning(orders=[3, 1, 3]).orders == (1, 3)
    assert [Conditioning(drift=d).degree for d in ("none", "auto", 0, 3)] == [-1, 1, 0, 3]
    assert Conditioning().nuisance_orders is None
    assert Conditioning(harmonics=(2, 3)).nuisance_orders == (2, 3)
    assert hash(Conditioning(orders=[1, 3])) == hash(Conditioning(orders=(1, 3)))


def test_keywords_are_the_fields():
    fields = {field.name for field in dataclasses.fields(Conditioning)}
    assert set(Treatments.__annotations__) == fields
    assert set(FitTreatments.__annotations__) == fields - {
        "moments", "refine", "settle", "transients", "band_hz", "still",
    }  # fmt: skip


def test_keywords_change_what_is_given():
    base = Conditioning(drift=2, harmonics=(2,))
    assert conditioning_of(base, {"drift": 0}) == Conditioning(drift=0, harmonics=(2,))
    assert conditioning_of(base, {}) is base
    assert conditioning_of(None, {}) == Conditioning()
    assert base.changed(settle=0.5).settle == 0.5


@pytest.mark.parametrize(
    ("treatments", "match"),
    [
        ({"orders": ()}, "no orders"),
        ({"orders": (0,)}, "orders of harmonics"),
        ({"harmonics": (-1,)}, "harmonics"),
        ({"drift": -2}, "drift of degree"),
        ({"drift": 10**6}, "drift of degree"),
        ({"settle": -1.0}, "settling time"),
        ({"settle": float("nan")}, "settling time"),
        ({"moments": True, "orders": (1, 3)}, "fundamental alone"),
        ({"band_hz": (5.0, 2.0)}, "a band from"),
    ],
)
def test_what_makes_no_sense_is_refused(treatments, match):
    with pytest.raises(DataError, match=match):
        Conditioning(**treatments)
