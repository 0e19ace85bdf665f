"""Releases that are planned: what they tell against what they told, textbook covariances, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import expm

import dashpot
from dashpot.app.cli import cli
from dashpot.arrays import Real
from dashpot.design.releases import ReleasePlan, plan_releases
from tests.two_masses import HELD

RIG = f"""
coordinates = ["x1", "x2"]
{HELD}[channels]
x1 = {{ of = "x1", unit = "mm", noise = 0.02 }}
x2 = {{ of = "x2", unit = "mm", noise = 0.02 }}
"""
TRUTH = np.array([1.0, 8000.0, 3000.0, 8.0, 3.0])
RATE, SIZE = 400.0, 5e-3


def state_matrix(theta: Real) -> Real:
    m2, k1, k2, c1, c2 = theta
    M = np.diag([2.0, m2])
    K, C = (np.array([[a + b, -b], [-b, b]]) for a, b in ((k1, k2), (c1, c2)))
    return np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])


def motion(theta: Real, start: Real, samples: int) -> Real:
    """x1 and x2 sample by sample, m, (samples, 2)."""
    step, z = expm(state_matrix(theta) / RATE), [start]
    for _ in range(samples - 1):
        z.append(step @ z[-1])
    return np.array(z)[:, :2]


def held(hold: int) -> Real:
    k1, k2 = TRUTH[1:3]
    shape = np.linalg.solve(np.array([[k1 + k2, -k2], [-k2, k2]]), np.eye(2)[hold])
    return np.concatenate([SIZE * shape / np.max(np.abs(shape)), np.zeros(2)])


def planned(**options: object) -> ReleasePlan:
    rig = dashpot.parse_rig(RIG)
    return plan_releases(rig.model, rig.channels, {}, **({"deflection": SIZE, "rate_hz": RATE} | options))


def test_what_a_release_tells_is_the_regression_of_its_samples() -> None:
    """(JᵀJ/σ²)⁻¹ over the unknowns and the four states at the start, slopes by differences."""
    plan = planned()
    (release,) = plan.together
    samples = round(release.record_s * RATE)
    start, columns = held(("x1", "x2").index(release.hold)), []
    for j in range(9):
        both = []
        for sign in (1, -1):
            theta, z = TRUTH.copy(), start.copy()
            if j < 5:
                theta[j] *= 1 + 1e-5 * sign
            else:
                z[j - 5] += 1e-6 * sign
            both.append(motion(theta, z, samples).ravel())
        columns.append((both[0] - both[1]) / (2e-5 * TRUTH[j] if j < 5 else 2e-6))
    J = np.stack(columns, axis=1) / 2e-5
    scale = np.linalg.norm(J, axis=0)
    sd = np.sqrt(np.diagonal(np.linalg.inv((J / scale).T @ (J / scale)))) / scale
    np.testing.assert_allclose(plan.sd, sd[:5], rtol=0.02)
    assert plan.figure == pytest.approx(np.sqrt(np.mean((sd[:5] / TRUTH) ** 2)), rel=0.02)


def test_identify_reaches_what_was_planned() -> None:
    plan = planned()
    (release,) = plan.together
    samples = round(release.record_s * RATE)
    x = motion(TRUTH, held(("x1", "x2").index(release.hold)), samples)
    x = 1e3 * x + 0.02 * np.random.default_rng(6).standard_normal(x.shape)
    data = {"time_s": np.arange(samples) / RATE, "x1": x[:, 0], "x2": x[:, 1]}
    estimate = dashpot.parse_rig(RIG).identify(data, judge=False)
    assert np.max(np.abs(estimate.values - TRUTH) / estimate.sd) < 4
    np.testing.assert_allclose(estimate.sd, plan.sd, rtol=0.05)


def test_the_best_hold_is_first_and_a_target_gives_the_deflection() -> None:
    plan = planned()
    assert [each.hold for each in plan.releases] == ["x1", "x2"]
    assert plan.releases[0].figure < plan.releases[1].figure
    rig = dashpot.parse_rig(RIG)
    asked = plan_releases(rig.model, rig.channels, {}, rate_hz=RATE, target=0.01)
    assert 0.0099 < asked.figure <= 0.01
    assert asked.together[0].largest == pytest.approx(SIZE * plan.figure / 0.01, rel=0.05)


@pytest.mark.parametrize(("of_motion", "reached"), [(0.0, True), (0.002, True), (0.02, False)])
def test_what_is_said_of_a_target_holds_at_the_deflection_that_is_proposed(
    of_motion: float, reached: bool
) -> None:
    """Noise that is a share of the motion grows with it, so that larger deflections tell less than in proportion."""
    rig = dashpot.parse_rig(RIG.replace("noise = 0.02", f"noise = 0.02, relative_noise = {of_motion}"))
    asked = plan_releases(rig.model, rig.channels, {}, rate_hz=RATE, target=0.003)
    size = asked.together[0].largest
    made = plan_releases(rig.model, rig.channels, {}, rate_hz=RATE, deflection=size)
    assert asked.figure == pytest.approx(made.figure, rel=1e-6)
    assert (made.figure <= 0.003) is reached
    assert ("is not reached" in asked.notes[-1]) is not reached


def test_recordings_that_share_a_time_are_no_longer_than_it() -> None:
    """Half a second of one release tells what a regression of half a second tells, not of the next longer length."""
    whole, less = planned(time_s=0.5), planned(time_s=0.499)
    assert whole.figure < less.figure < 1.02 * whole.figure


@pytest.mark.parametrize("noise", [", noise = 1e-5", ", relative_noise = 0.01", ""])
def test_releases_that_tell_little_alone_are_put_together(noise: str) -> None:
    """Two masses that do not touch: one release cannot tell of both, and shows nothing in the other's channel."""
    text = """
    coordinates = ["x1", "x2"]
    masses = { m1 = { at = "x1", value = 2 }, m2 = { at = "x2", value = 1 } }
    springs = { k1 = { between = ["x1", "ground"], guess = 8000 }, k2 = { between = ["x2", "ground"], guess = 3000 } }
    dampers = { c1 = { between = ["x1", "ground"], guess = 8 }, c2 = { between = ["x2", "ground"], guess = 3 } }
    channels = { x1 = { of = "x1" NOISE }, x2 = { of = "x2" NOISE } }
    """
    rig = dashpot.parse_rig(text.replace("NOISE", noise))
    plan = plan_releases(rig.model, rig.channels, {}, deflection=SIZE, rate_hz=RATE)
    assert sorted(each.hold for each in plan.together) == ["x1", "x2"]
    assert plan.figure < 0.01
    assert all(each.figure == np.inf for each in plan.releases)


def test_a_rig_that_never_comes_to_rest_is_recorded_for_two_hundred_periods_at_most() -> None:
    rig = dashpot.parse_rig("""
    coordinates = ["x"]
    masses = { m = { at = "x", value = 2 } }
    springs = { k = { between = ["x", "ground"], guess = 8000 } }
    channels = { x = { of = "x", noise = 1e-5 } }
    """)
    (release,) = plan_releases(rig.model, rig.channels, {}, rate_hz=RATE).together
    assert release.record_s == pytest.approx(200 * 2 * np.pi / np.sqrt(8000 / 2), rel=0.01)


def test_a_rig_without_unknowns_is_refused_in_one_line() -> None:
    rig = dashpot.parse_rig(RIG.replace("guess", "value"))
    with pytest.raises(dashpot.UsageError) as refused:
        plan_releases(rig.model, rig.channels, {})
    assert len(refused.value.problems) == 1


def test_the_command_says_where_how_far_and_how_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(RIG)
    design = ["design", "rig.toml", "--stroke", "5mm", "--rate", "400", "--json", "plan.json"]
    done = CliRunner().invoke(cli, design, catch_exceptions=False)
    assert done.exit_code == 0
    assert "Hold x1 5.00 mm out" in done.output
    plan = json.loads(Path("plan.json").read_text())
    assert plan["together"][0]["hold"] == "x1"
    assert plan["predicted"]["k1"]["relative_sd"] < 0.01
    for wrong in (
        ["--band", "1:9"],
        ["--samples", "100"],
        ["--set", "x=1"],
        ["--for", "volume"],
        ["--for", "m9"],
    ):
        with pytest.raises(dashpot.DashpotError) as refused:
            CliRunner().invoke(cli, ["design", "rig.toml", *wrong], catch_exceptions=False)
        assert len(refused.value.problems) == 1
    Path("rig.toml").write_text(
        RIG.replace('k1 = { between = ["x1", "ground"]', 'k1 = { between = ["x1", "ground"], law = "cubic"')
    )
    with pytest.raises(dashpot.DashpotError):
        CliRunner().invoke(cli, ["design", "rig.toml"], catch_exceptions=False)
