"""What the reproduction of Yamane (1989) shows, in words, from the numbers of `reproduce.yamane1989.findings`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dashpot.io.words import joined
from dashpot.present.pages.yamane1989.tables import KINDS, signed
from dashpot.reproduce.yamane1989.findings import (
    Efficiency,
    FewerUnknowns,
    IntervalCoverage,
    LeastSquaresBias,
    Luck,
    OneDraw,
    PaperOrder,
    PrintedAmongDraws,
    SamplesForOnePerCent,
)
from dashpot.reproduce.yamane1989.reproduction import Reproduction
from dashpot.reproduce.yamane1989.tables import Rank

WELL_KNOWN = 1.0  # standard error of a share, in points, with which nobody needs more draws


@dataclass(frozen=True)
class Statement:
    """A finding in words."""

    title: str
    text: str


def sentences(reproduction: Reproduction) -> tuple[Statement, ...]:
    """All findings, in the order of the paper."""
    findings = reproduction.findings
    return (
        _printed_among_draws(findings.printed_among_draws),
        _bias(findings.bias),
        _efficiency(findings.efficiency),
        _one_draw(findings.one_draw),
        _luck(findings.luck),
        _coverage(findings.coverage),
        _fewer_unknowns(findings.fewer_unknowns),
        _order(findings.order, reproduction.ranking),
        _samples(findings.samples),
    )


def headline(reproduction: Reproduction) -> str:
    """Whether the paper is found again, in one sentence."""
    among = reproduction.findings.printed_among_draws
    return (
        f"{among.inside} of the paper's {among.total} printed errors are such as its methods give on its rig."
    )


def statements(reproduction: Reproduction) -> tuple[str, ...]:
    """How accurate the paper's methods are, and what its intervals are worth."""
    found = reproduction.findings
    worst = max(found.bias.worst, key=lambda each: abs(each.mean))
    ranges = [
        f"{low:.0f} to {high:.0f} % with {name}" for name, (low, high) in found.coverage.by_method.items()
    ]
    return (
        (
            f"Spread of the parameters at 10 % noise, CASE-3 (rms): {found.efficiency.iv:.1f} % with the paper's "
            f"instrumental variables, {found.efficiency.oiv:.1f} % optimally weighted; no unbiased method can do "
            f"better than {found.efficiency.bound:.1f} %. Least squares is off by up to {abs(worst.mean):.0f} % "
            f"({worst.parameter} at {worst.level:g} %)."
        ),
        f"95 % intervals hold the true value in {joined(ranges)} of the draws.",
    )


def next_steps(reproduction: Reproduction) -> tuple[str, ...]:
    """What to do with it."""
    error = reproduction.findings.coverage.standard_error
    steps = (
        "On data of your own, take the optimally weighted form: dashpot identify RIG DATA --method oiv.",
    )
    more = f"{reproduction.draws:,} draws tell a share of 95 % to ± {error:.1f} points: take --draws 1000 to judge it."
    return steps if error <= WELL_KNOWN else (*steps, more)


def _printed_among_draws(among: PrintedAmongDraws) -> Statement:
    return Statement(
        "The paper's rig is found again",
        f"{among.inside} of the {among.total} printed errors lie within the middle 95 % of the draws (independent "
        f"values would give {0.95 * among.total:.0f}; these are not independent). Column by column, all parameters "
        f"together, a draw is farther from the mean than the paper's with a probability of {among.least_p:.2g} to "
        f"{among.largest_p:.2g}: nothing speaks against the rig and the noise assumed here.",
    )


def _bias(bias: LeastSquaresBias) -> Statement:
    parts = [
        f"at {worst.level:g} % it puts {worst.parameter} off by {signed(worst.mean, 1)} % on average, "
        f"{abs(worst.mean) / worst.spread:.0f} times its spread"
        for worst in bias.worst
    ]
    text = "; ".join(parts)
    return Statement(
        "Least squares is biased, and more samples do not help",
        f"{text[0].upper()}{text[1:]}. From 5 to 10 % the bias grows by a factor of {bias.growth:.1f}: nearly with the "
        f"square of the noise, whose power enters the normal matrix. Its 95 % intervals at 10 % hold the truth in "
        f"{bias.coverage[0]:.0f} to {bias.coverage[1]:.0f} % of the draws, depending on the parameter.",
    )


def _efficiency(efficiency: Efficiency) -> Statement:
    ratio = efficiency.iv / efficiency.bound
    least, largest = efficiency.oiv_ratios
    return Statement(
        "The paper's instrumental variables do not use the data fully",
        f"CASE-3, 10 %: rms spread of the six parameters {efficiency.iv:.2f} % with iv, {efficiency.oiv:.2f} % with "
        f"oiv, Cramér-Rao bound {efficiency.bound:.2f} %. iv stands at {ratio:.2f} × the bound: it needs "
        f"{ratio**2:.1f} × the samples that the data need. The optimally weighted form is at {least:.3f} to "
        f"{largest:.3f} × the bound in the four cases.",
    )


def _one_draw(draw: OneDraw) -> Statement:
    return Statement(
        "Table 2 shows one noise draw four times",
        f"The printed iv errors at 5, 10 and 20 %, divided by the level, agree within {draw.disagreement:.0f} % "
        f"(correlation of any two columns at least {draw.correlation:.4f}), where a draw at 20 % has a spread of "
        f"{draw.spread:.1f} %. The same random numbers were scaled to each level: the table's four levels are one "
        "piece of evidence.",
    )


def _luck(luck: Luck) -> Statement:
    return Statement(
        "The paper's draw was a lucky one",
        f"Its iv errors at CASE-3, 10 % have an rms of {luck.rms:.2f} %; {luck.as_good:.1f} % of the draws are as "
        f"good, the typical one has {luck.spread:.1f} %. That all six parameters stay within about 2 % at a noise "
        f"level of 20 % (section 3.1; printed maximum {luck.largest:.2f} %) happens in {luck.within['iv']:.1f} % of "
        f"the draws with iv and in {luck.within['oiv']:.1f} % with oiv.",
    )


def _coverage(coverage: IntervalCoverage) -> Statement:
    ranges = [f"{low:.1f} to {high:.1f} % with {name}" for name, (low, high) in coverage.by_method.items()]
    return Statement(
        "The intervals hold" if coverage.holds else "Some intervals do not hold",
        f"95 % intervals hold the true value, over the four cases and six parameters, in {joined(ranges)} of "
        f"{coverage.draws:,} draws (standard error of each figure {coverage.standard_error:.1f} points).",
    )


def _fewer_unknowns(fewer: FewerUnknowns) -> Statement:
    def changes(numbers: Mapping[str, tuple[float, float]]) -> str:
        return ", ".join(f"{name} {six:.2f} → {four:.2f} %" for name, (six, four) in numbers.items())

    count, worse = len(fewer.spread), fewer.worse
    on_average = f", the draws on average are for {joined(worse)}" if worse else ""
    return Statement(
        f"With c1 and c2 known, iv gains on {count - len(worse)} of {count} parameters",
        f"Spread of iv, 6 unknowns → 4: {changes(fewer.spread)}. Bound: {changes(fewer.bound)}. Table 3 finds the "
        f"accuracy better on the whole; its single draw was worse for {joined(fewer.worse_printed) or 'none'}"
        f"{on_average}. Knowing more cannot raise the bound, but it can spoil an estimator that does not weigh its "
        "equations.",
    )


def _order(order: PaperOrder, ranking: Sequence[Rank]) -> Statement:
    parts = []
    for kind, words in KINDS.items():
        for name in ("iv", "oiv"):
            ranks = [rank for rank in ranking if rank.kind == kind]
            spread = {rank.case[-1]: rank.iv if name == "iv" else rank.oiv for rank in ranks}
            best_first = " < ".join(
                f"{case} ({spread[case]:.2f} %)" for case in sorted(spread, key=spread.__getitem__)
            )
            parts.append(f"{words[0].upper()}{words[1:]}, {name}: {best_first}")
    survives = order.kept["relative"]
    return Statement(
        f"The paper's order of its cases {'survives' if survives else 'does not survive'}",
        f"Rms spread by case, best first. {'. '.join(parts)}. The paper ranks CASE-3 before CASE-2 before CASE-1 from "
        f"one draw each; under its own noise the true order of iv is {'the same' if survives else 'another'}, and "
        f"single draws come in the paper's order {order.by_chance:.0f} % of the time (17 % were all three alike). With "
        f"noise of constant size the paper's order {'holds' if order.kept['constant'] else 'does not hold either'}.",
    )


def _samples(samples: SamplesForOnePerCent) -> Statement:
    return Statement(
        f"{samples.samples:,} samples are {'' if samples.enough else 'not '}enough for 1 %",
        f"That all six parameters are within about 1 % at {samples.samples:,} samples (section 3.3) happens in "
        f"{samples.within:.1f} % of the draws with iv. An rms spread of 1 % takes about {samples.needed['iv']:,.0f} "
        f"samples with iv and {samples.needed['oiv']:,.0f} with oiv.",
    )
